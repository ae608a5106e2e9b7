// Curves of joint angles with bands and limits, and the strip of statuses and qualities. Canvas 2D.

const FINGERS = ["thumb", "index", "middle", "ring", "little"];
const STATUS_COLOURS = ["--tracked", "--lost", "--recovered", "--no-hand"]; // in the order of the results' statuses

const theme = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// A canvas at the screen's resolution; the context counts in CSS pixels.
function prepared(canvas) {
  const scale = Math.min(2, window.devicePixelRatio || 1), width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = Math.max(1, Math.round(width * scale));
  canvas.height = Math.max(1, Math.round(height * scale));
  const pen = canvas.getContext("2d");
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  return { pen, width, height };
}

// First row whose time is not before the given one.
function rowFrom(times, time) {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < time) low = middle + 1; else high = middle;
  }
  return low;
}

// A step of 1, 2 or 5 times a power of ten, some `count` of which make up the extent.
function tickStep(extent, count) {
  const rough = extent / count, power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((x) => x * power).find((step) => step >= rough * 0.999);
}

class Chart {
  constructor(canvas, results, angle) {
    this.canvas = canvas;
    this.results = results;
    this.angle = angle;
    const { lower, upper } = results[0].hand;
    this.limits = [lower[angle], upper[angle]];
    let low = this.limits[0], high = this.limits[1];
    for (const result of results)
      for (let row = 0; row < result.time.length; row++) {
        const value = result.angles[30 * row + angle];
        if (value < low) low = value;
        if (value > high) high = value;
      }
    const spare = 0.06 * (high - low) + 1;
    this.range = [low - spare, high + spare];
  }

  // Draws the time from `start` to `end`.
  draw(start, end) {
    const { pen, width, height } = prepared(this.canvas), [low, high] = this.range;
    this.left = 34;
    const bottom = height - 14, extent = Math.max(end - start, 1e-6);
    const x = (time) => this.left + ((time - start) / extent) * (width - this.left - 4);
    const y = (value) => 4 + ((high - value) / (high - low)) * (bottom - 4);
    this.timeAt = (place) => start + ((place - this.left) / (width - this.left - 4)) * extent;
    this.placeOf = x;
    this._axes(pen, { x, y, start, end, bottom, width });
    pen.save();
    pen.beginPath();
    pen.rect(this.left, 0, width - this.left, bottom);
    pen.clip();
    this.results.forEach((result, i) => this._curve(pen, result, i ? "--b" : "--a", { x, y, start, end, columns: width - this.left - 4 }));
    pen.restore();
  }

  _axes(pen, { x, y, start, end, bottom, width }) {
    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = theme("--soft");
    pen.strokeStyle = theme("--line");
    pen.lineWidth = 1;
    const step = tickStep(this.range[1] - this.range[0], 3);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (let value = Math.ceil(this.range[0] / step) * step; value <= this.range[1]; value += step) {
      pen.fillText(`${Math.round(value)}°`, this.left - 5, y(value));
      pen.beginPath(); pen.moveTo(this.left, y(value)); pen.lineTo(width - 4, y(value)); pen.stroke();
    }
    pen.textAlign = "center";
    pen.textBaseline = "alphabetic";
    const pace = tickStep(Math.max(end - start, 1e-3), 4);
    for (let k = Math.ceil(start / pace); k * pace <= end + 1e-9; k++) {
      const place = Math.min(x(k * pace), width - 14);
      pen.fillText(`${+(k * pace).toFixed(3)} s`, place, bottom + 12);
    }
    pen.strokeStyle = theme("--soft");
    pen.setLineDash([4, 4]);
    for (const limit of this.limits) { pen.beginPath(); pen.moveTo(this.left, y(limit)); pen.lineTo(width - 4, y(limit)); pen.stroke(); }
    pen.setLineDash([]);
  }

  // Runs without a gap, each a band and a line; of many rows at one pixel the lowest and the highest count.
  _curve(pen, result, name, { x, y, start, end, columns }) {
    const first = Math.max(0, rowFrom(result.time, start) - 1), last = Math.min(result.time.length - 1, rowFrom(result.time, end));
    const group = Math.max(1, Math.floor((last - first + 1) / Math.max(1, columns)));
    const runs = [];
    let run = null;
    for (let row = first; row <= last; row += group) {
      let low = Infinity, high = -Infinity, below = Infinity, above = -Infinity;
      for (let own = row; own < Math.min(row + group, last + 1); own++) {
        const value = result.angles[30 * own + this.angle];
        if (Number.isNaN(value)) continue;
        const half = BAND_STD * (result.std[30 * own + this.angle] || 0);
        low = Math.min(low, value); high = Math.max(high, value);
        below = Math.min(below, value - half); above = Math.max(above, value + half);
      }
      if (high < low) { run = null; continue; }
      if (!run) runs.push((run = []));
      run.push([x(result.time[row]), y(low), y(high), y(below), y(above)]);
    }
    pen.fillStyle = theme(`${name}-band`);
    pen.strokeStyle = theme(name);
    pen.lineWidth = 1.5;
    for (const points of runs) {
      if (points.length === 1) points.push([points[0][0] + 1, ...points[0].slice(1)]);
      pen.beginPath();
      points.forEach(([at, , , below]) => pen.lineTo(at, below));
      [...points].reverse().forEach(([at, , , , above]) => pen.lineTo(at, above));
      pen.fill();
      pen.beginPath();
      points.forEach(([at, low, high]) => { pen.lineTo(at, low); if (high !== low) pen.lineTo(at, high); });
      pen.stroke();
    }
  }
}

// Rows of the strip: the status of each result, then the quality of each finger of the first.
class Strip {
  constructor(canvas, results) {
    this.canvas = canvas;
    this.results = results;
    this.left = 46;
    canvas.style.height = `${14 * results.length + (results[0].quality ? 45 : 4)}px`;
  }

  // times: all of the timeline. left: where the first frame stands, px; width: of all frames.
  draw(times) {
    const { pen, width } = prepared(this.canvas), columns = Math.max(1, Math.floor(width - this.left));
    const start = times[0], extent = Math.max(times[times.length - 1] - start, 1e-6);
    pen.font = "10px system-ui, sans-serif";
    pen.textBaseline = "top";
    const colours = STATUS_COLOURS.map(theme), [good, bad, soft] = ["--good", "--bad", "--soft"].map(theme);
    const heights = [10, 4, 10, 2]; // so that statuses differ without their colours too
    this.results.forEach((result, i) => {
      pen.fillStyle = soft;
      pen.fillText(this.results.length > 1 ? `status ${"AB"[i]}` : "status", 0, 14 * i);
      for (let column = 0; column < columns; column++) {
        const [from, to] = this._rows(result, start, extent, column, columns);
        let worst = -1;
        for (let row = from; row < to; row++) if (result.status[row] !== 0 && worst !== 1) worst = result.status[row];
        if (to <= from) continue;
        const status = worst < 0 ? 0 : worst;
        pen.fillStyle = colours[status];
        pen.fillRect(this.left + column, 14 * i + (10 - heights[status]), 1, heights[status]);
        if (status === 2 && column % 4 < 2) pen.clearRect(this.left + column, 14 * i, 1, 5);
      }
    });
    const [result] = this.results;
    if (!result.quality) return;
    const top = 14 * this.results.length;
    FINGERS.forEach((finger, f) => {
      pen.fillStyle = soft;
      pen.fillText(finger, 0, top + 9 * f - 2);
      for (let column = 0; column < columns; column++) {
        const [from, to] = this._rows(result, start, extent, column, columns);
        let least = NaN;
        for (let row = from; row < to; row++) {
          const value = result.quality[5 * row + f];
          if (!Number.isNaN(value) && !(value >= least)) least = value;
        }
        if (Number.isNaN(least)) continue;
        pen.fillStyle = least < result.determined ? bad : good;
        pen.globalAlpha = least < result.determined ? 1 : 0.35 + 0.65 * least;
        const high = least < result.determined ? 3 : 7;
        pen.fillRect(this.left + column, top + 9 * f + 7 - high, 1, high);
        pen.globalAlpha = 1;
      }
    });
  }

  _rows(result, start, extent, column, columns) {
    const from = rowFrom(result.time, start + (extent * (column - 0.5)) / columns);
    const to = rowFrom(result.time, start + (extent * (column + 0.5)) / columns);
    return to > from ? [from, to] : this._held(result, from, extent, columns);
  }

  // With fewer frames than pixels, the frame before lasts until the next.
  _held(result, from, extent, columns) {
    const row = Math.min(result.time.length - 1, Math.max(0, from - 1));
    const isBeside = result.time.length < columns && from > 0 && from < result.time.length;
    return isBeside ? [row, row + 1] : [0, 0];
  }
}

// Puts the page together.

const element = (id) => document.getElementById(id);

function made(tag, content, attributes = {}) {
  const node = document.createElement(tag);
  if (content !== undefined) node.textContent = content;
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  return node;
}

// All times of the results in order, equal ones once, and the row of each result there; -1 where it has none.
function timeline(results) {
  const [first, second] = results;
  const gap = first.time.length > 1 ? (first.time[first.time.length - 1] - first.time[0]) / (first.time.length - 1) : 0.04;
  const times = second ? [...first.time, ...second.time].sort((a, b) => a - b).filter((time, i, all) => !i || time - all[i - 1] > 0.3 * gap) : [...first.time];
  const rows = results.map((result) => Int32Array.from(times, (time) => {
    const row = rowFrom(result.time, time - 0.5 * gap);
    return row < result.time.length && Math.abs(result.time[row] - time) <= 0.5 * gap ? row : -1;
  }));
  return { times, rows };
}

function showVideo() {
  const text = element("video-data").textContent.trim();
  if (!text) { document.querySelector(".stage").classList.add("still"); return null; }
  const video = element("video");
  video.src = URL.createObjectURL(blobOf(text, "video/mp4"));
  element("video-data").textContent = ""; // the page needs it once
  element("video-box").hidden = false;
  video.addEventListener("error", () => fail("The video cannot be played by this browser."));
  return video;
}

function fail(text) {
  element("failure").hidden = false;
  element("failure").append(made("span", `${text} `));
}

// A chart for every angle that was free in one result.
function buildCharts(results, titles) {
  const charts = [], isFree = (angle) => results.some((result) => result.is_free[angle]);
  for (const finger of FINGERS) {
    const own = results[0].names.map((name, angle) => [name, angle]).filter(([name, angle]) => name.startsWith(`${finger}_`) && isFree(angle));
    if (!own.length) continue;
    const group = made("div", undefined, { class: "finger" });
    element("charts").append(made("h3", finger), group);
    for (const [name, angle] of own) {
      const box = made("div", undefined, { class: "chart" }), line = made("p"), title = titles[name].slice(finger.length + 1);
      const value = made("span"), cursor = made("div", undefined, { class: "cursor" });
      const canvas = made("canvas", undefined, { role: "img", "aria-label": `${titles[name]} over time` });
      line.append(made("span", title), value);
      box.append(line, canvas, cursor);
      group.append(box);
      charts.push({ angle, value, canvas, cursor, chart: new Chart(canvas, results, angle) });
    }
  }
  const held = results[0].names.filter((_, angle) => !isFree(angle)).map((name) => titles[name]);
  if (held.length) element("held").textContent = `Held, not estimated: ${held.join(", ")}.`;
  return charts;
}

// A column a finger: quality, and how far its tip is known; told again in every frame.
function buildFingers(results, hands) {
  const head = made("tr"), body = made("tbody"), top = made("thead");
  head.append(made("th", "Now"), ...FINGERS.map((finger) => made("th", finger, { scope: "col" })));
  top.append(head);
  const cells = results.map((_, i) => {
    const letter = results.length > 1 ? `${"AB"[i]}: ` : "", rows = [made("tr"), made("tr")];
    rows[0].append(made("th", `${letter}quality`, { scope: "row" }));
    rows[1].append(made("th", `${letter}tip`, { scope: "row" }));
    const own = FINGERS.map((finger) => {
      const quality = made("td"), tip = made("td"), text = made("span");
      const meter = made("meter", undefined, { min: 0, max: 1, low: 0.5, optimum: 1, "aria-label": `${letter}quality of the ${finger}` });
      quality.append(meter, " ", text);
      rows[0].append(quality);
      rows[1].append(tip);
      return { meter, text, tip };
    });
    body.append(...(results[i].quality ? rows : rows.slice(1)));
    return own;
  });
  element("fingers").append(top, body);
  return (rows) => cells.forEach((own, i) => own.forEach(({ meter, text, tip }, f) => {
    const hasHand = rows[i] >= 0 && !Number.isNaN(results[i].position[3 * rows[i]]);
    const quality = hasHand ? qualityOf(results[i], rows[i], f) : undefined;
    meter.hidden = quality === undefined;
    meter.value = quality ?? 0;
    text.textContent = quality === undefined ? "–" : `${Math.round(100 * quality)} %`;
    text.className = quality < results[i].determined ? "open" : "";
    tip.textContent = hasHand && hands[i].radii[f] > 0 ? `± ${(1000 * hands[i].radii[f]).toFixed(0)} mm` : "–";
  }));
}

function legend(results) {
  const place = element("legend"), shown = results[0].statuses.map((name, i) => [name, STATUS_COLOURS[i]]);
  place.append("Status:");
  for (const [name, colour] of shown) {
    const mark = made("i");
    mark.style.background = `var(${colour})`;
    place.append(mark, name);
  }
  if (results[0].quality) {
    place.append(`. Fingers${results.length > 1 ? " of A" : ""}:`);
    for (const [name, colour] of [["determined", "--good"], ["not determined (quality below 50 %)", "--bad"]]) {
      const mark = made("i");
      mark.style.background = `var(${colour})`;
      place.append(mark, name);
    }
  }
  if (results.length > 1) {
    place.append(". Curves:");
    for (const [letter, colour] of [["A", "--a"], ["B", "--b"]]) {
      const mark = made("i");
      mark.style.background = `var(${colour})`;
      place.append(mark, letter);
    }
  }
}

// Angles and standard deviations as a table that other programs read.
function table(result) {
  const number = (value, digits) => (Number.isNaN(value) ? "" : value.toFixed(digits));
  const lines = [["frame", "time_s", "status", ...result.names.flatMap((name) => [`${name}_deg`, `${name}_std_deg`])].join(",")];
  for (let row = 0; row < result.time.length; row++) {
    const cells = [result.frame[row], number(result.time[row], 4), result.statuses[result.status[row]].replace(" ", "_")];
    for (let i = 30 * row; i < 30 * row + 30; i++) cells.push(number(result.angles[i], 2), number(result.std[i], 2));
    lines.push(cells.join(","));
  }
  return lines.join("\n") + "\n";
}

function buildSaves(results) {
  results.forEach((result, i) => {
    const button = made("button", `Save angles${results.length > 1 ? ` of ${"AB"[i]}` : ""} (CSV)`, { type: "button" });
    button.addEventListener("click", () => {
      const link = made("a", "", { download: `${result.name}.angles.csv` });
      link.href = URL.createObjectURL(new Blob([table(result)], { type: "text/csv" }));
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    });
    element("saves").append(button, " ");
  });
}

function chooseTheme(redraw) {
  const button = element("theme"), root = document.documentElement, dark = window.matchMedia("(prefers-color-scheme: dark)");
  const set = (isDark) => {
    root.dataset.theme = isDark ? "dark" : "light";
    button.setAttribute("aria-pressed", String(isDark));
    redraw();
  };
  button.addEventListener("click", () => set(root.dataset.theme !== "dark"));
  dark.addEventListener("change", (event) => set(event.matches));
  set(dark.matches);
}

async function start() {
  const content = await unpackAll(JSON.parse(element("data").textContent));
  const { results, titles } = content, video = showVideo();
  const { times, rows } = timeline(results), player = new Player(times, video), hands = results.map((result) => new Hand(result));
  let scene = null;
  try { scene = new Scene(element("scene"), hands); } catch (error) { fail(`The hand in 3D cannot be drawn (${error.message}).`); }
  const charts = buildCharts(results, titles), strip = new Strip(element("strip"), results), tellFingers = buildFingers(results, hands);
  legend(results);
  buildSaves(results);
  const scrub = element("scrub");
  scrub.max = times.length - 1;
  let shown = [NaN, NaN];

  const windowOf = (time) => {
    const span = Number(element("span").value), end = times[times.length - 1];
    if (!span || span >= end - times[0]) return [times[0], end];
    const from = times[0] + span * Math.floor((time - times[0]) / span);
    return [from, from + span];
  };
  const drawCharts = () => {
    shown = windowOf(player.time);
    charts.forEach(({ chart }) => chart.draw(...shown));
    strip.draw(times);
  };
  const onFrame = () => {
    const place = player.place, own = rows.map((of) => of[place]);
    if (scene) scene.show(own); else hands.forEach((hand, i) => hand.pose(own[i]));
    const next = windowOf(player.time);
    if (next[0] !== shown[0] || next[1] !== shown[1]) drawCharts();
    for (const { angle, value, cursor, chart } of charts) {
      cursor.style.left = `${chart.placeOf(player.time)}px`;
      value.textContent = own.map((row, i) => {
        const degrees = row < 0 ? NaN : results[i].angles[30 * row + angle];
        return Number.isNaN(degrees) ? "–" : `${degrees.toFixed(1)}° ± ${(BAND_STD * results[i].std[30 * row + angle]).toFixed(1)}°`;
      }).join(" | ");
    }
    tellFingers(own);
    const status = own.map((row, i) => (row < 0 ? "no frame" : results[i].statuses[results[i].status[row]])).join(" | ");
    const first = own.findIndex((row) => row >= 0), number = first < 0 ? "–" : results[first].frame[own[first]];
    const text = `frame ${number} · ${player.time.toFixed(2)} s · ${status}`;
    element("clock").textContent = text;
    scrub.value = place;
    scrub.setAttribute("aria-valuetext", text);
  };
  player.onFrame = onFrame;
  player.onState = (isPlaying) => {
    element("play").textContent = isPlaying ? "❚❚" : "▶";
    element("play").setAttribute("aria-label", isPlaying ? "Pause" : "Play");
  };
  listen(player, { scene, charts, strip });
  element("span").addEventListener("change", () => { drawCharts(); onFrame(); });
  const redraw = () => { drawCharts(); onFrame(); };
  chooseTheme(redraw);
  let waiting = 0;
  window.addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(redraw, 80); });
  window.report = { player, hands, results, scene };
  document.documentElement.dataset.ready = "yes";
}

function listen(player, { scene, charts, strip }) {
  const toggle = () => (player.isPlaying ? player.pause() : player.play());
  const step = (by) => { player.pause(); player.go(player.place + by); };
  element("play").addEventListener("click", toggle);
  element("back").addEventListener("click", () => step(-1));
  element("forth").addEventListener("click", () => step(1));
  element("scrub").addEventListener("input", (event) => { player.pause(); player.go(Number(event.target.value)); });
  element("speed").addEventListener("change", (event) => player.setSpeed(Number(event.target.value)));
  if (player.video) player.video.addEventListener("click", toggle);
  document.addEventListener("keydown", (event) => {
    if (event.key === " " && !event.target.closest("button, select, input, a")) { toggle(); event.preventDefault(); }
  });
  for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => scene && scene.see(button.dataset.view));
  element("tips").addEventListener("change", (event) => { if (scene) { scene.hasTips = event.target.checked; scene.draw(); } });
  const scrubbed = (canvas, timeAt) => {
    const go = (event) => {
      if (!event.buttons) return;
      player.pause();
      player.goTo(timeAt(event.clientX - canvas.getBoundingClientRect().left));
    };
    canvas.addEventListener("pointerdown", go);
    canvas.addEventListener("pointermove", go);
  };
  for (const { canvas, chart } of charts) scrubbed(canvas, (x) => chart.timeAt(x));
  const { canvas, left } = strip, [first, last] = [player.times[0], player.times[player.times.length - 1]];
  scrubbed(canvas, (x) => first + ((x - left) / Math.max(1, canvas.clientWidth - left)) * (last - first));
}

start().catch((error) => {
  fail(`This page cannot be shown (${error.message}). It needs a browser of 2023 or later.`);
  console.error(error);
});

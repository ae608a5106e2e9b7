// The time that video, hand and curves share: frames of a timeline, played at a speed.

class Player {
  // times: seconds, increasing. video: an element, or null; its time counts from the first frame on.
  constructor(times, video) {
    this.times = times;
    this.video = video;
    this.place = 0;
    this.speed = 1;
    this.isPlaying = false;
    this.onFrame = () => {};
    this.onState = () => {};
    if (video) {
      video.addEventListener("pause", () => { if (this.isPlaying && video.paused && !video.seeking) this.pause(); });
      video.addEventListener("error", () => { this.video = null; }); // the hand plays by itself then
      video.addEventListener("seeked", () => { if (!this.isPlaying) this._follow(); });
    }
  }

  get time() { return this.times[this.place]; }

  play() {
    if (this.isPlaying) return;
    if (this.place >= this.times.length - 1) this.go(0);
    this.isPlaying = true;
    this.started = null;
    if (this.video) {
      this.video.playbackRate = this.speed;
      this.video.play().catch(() => this.pause());
    }
    this.onState(true);
    requestAnimationFrame((now) => this._tick(now));
  }

  pause() {
    if (!this.isPlaying) return;
    this.isPlaying = false;
    if (this.video) this.video.pause();
    this.onState(false);
  }

  setSpeed(speed) {
    this.speed = speed;
    this.started = null;
    if (this.video) this.video.playbackRate = speed;
  }

  // Goes to a frame of the timeline.
  go(place) {
    this.place = Math.max(0, Math.min(this.times.length - 1, Math.round(place)));
    this.started = null;
    if (this.video) this.video.currentTime = this.time - this.times[0] + 1e-3;
    this.onFrame();
  }

  goTo(time) {
    const after = rowFrom(this.times, time), before = Math.max(0, after - 1);
    this.go(after < this.times.length && this.times[after] - time < time - this.times[before] ? after : before);
  }

  // The frame that lasts at a time, seconds from the first frame on.
  _placeAt(seconds) {
    return Math.max(0, rowFrom(this.times, this.times[0] + seconds + 2e-3) - 1);
  }

  _follow() {
    const place = this._placeAt(this.video.currentTime);
    if (place !== this.place) { this.place = place; this.onFrame(); }
  }

  _tick(now) {
    if (!this.isPlaying) return;
    const last = this.times.length - 1;
    let place;
    if (this.video && !this.video.ended && this.video.readyState > 0 && this._lasts()) place = this._placeAt(this.video.currentTime);
    else {
      if (this.started === null) { this.started = now; this.from = this.time - this.times[0]; }
      place = this._placeAt(this.from + (this.speed * (now - this.started)) / 1000);
    }
    if (place !== this.place) { this.place = Math.min(place, last); this.onFrame(); }
    if (place >= last && !(this.video && this._lasts() && !this.video.ended)) this.pause();
    else requestAnimationFrame((next) => this._tick(next));
  }

  // Whether the video goes on where the timeline is: another result may be longer.
  _lasts() {
    return this.time - this.times[0] <= this.video.duration + 0.05;
  }
}

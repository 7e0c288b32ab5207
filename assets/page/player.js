// @ts-check
"use strict";
// Time: one clock that everything on a page follows, its buttons, slider and keys.
(() => {
  const P = (globalThis.Propwash ??= {});

  class Player {
    /** @param {number} from first moment, s @param {number} to last moment, s */
    constructor(from, to) {
      this.from = from;
      this.to = to;
      this.time = from;
      this.speed = 1;
      this.playing = false;
      /** @type {((time: number) => void)[]} */
      this.followers = [];
      this.last = 0;
      /** @type {any} */
      this.slider = null;
    }

    /** Calls a function now and whenever the moment changes. @param {(time: number) => void} then */
    on(then) {
      this.followers.push(then);
      then(this.time);
    }

    /** @param {number} time s */
    set(time) {
      this.time = Math.min(Math.max(time, this.from), this.to);
      this.show();
      this.followers.forEach((then) => then(this.time));
    }

    /** Other limits, as of another world. @param {number} from @param {number} to */
    limits(from, to) {
      [this.from, this.to] = [from, to];
      this.set(this.time);
    }

    toggle() {
      if (this.playing) this.pause();
      else this.play();
    }

    play() {
      if (this.time >= this.to) this.set(this.from);
      this.playing = true;
      this.last = performance.now();
      this.show();
      requestAnimationFrame((now) => this.step(now));
    }

    pause() {
      this.playing = false;
      this.show();
    }

    /** @param {number} now ms */
    step(now) {
      if (!this.playing) return;
      const passed = Math.min(Math.max(now - this.last, 0), 250) / 1000;
      this.last = now;
      this.set(this.time + passed * this.speed);
      if (this.time >= this.to) this.pause();
      else requestAnimationFrame((next) => this.step(next));
    }

    show() {
      if (!this.slider) return;
      this.slider.min = this.from;
      this.slider.max = this.to;
      this.slider.value = this.time;
      this.slider.setAttribute("aria-valuetext", this.time.toFixed(2) + " s");
      this.told.textContent = this.time.toFixed(2) + " s";
      const word = this.playing ? "Pause" : "Play";
      if (this.button.textContent !== word) this.button.textContent = word;
    }

    /** The bar with button, speed, slider and clock. */
    controls() {
      this.button = P.el("button", { type: "button", class: "play", onclick: () => this.toggle() }, "Play");
      const speeds = [0.1, 0.25, 0.5, 1, 2, 4].map((s) => P.el("option", { value: s, selected: s === 1 }, s + "×"));
      const speed = P.el("select", { "aria-label": "speed" }, ...speeds);
      speed.addEventListener("change", () => (this.speed = Number(speed.value)));
      this.slider = P.el("input", { type: "range", min: this.from, max: this.to, step: 0.01, "aria-label": "time" });
      this.slider.addEventListener("input", () => this.set(Number(this.slider.value)));
      this.told = P.el("output", { class: "clock" });
      this.show();
      return P.el("div", { class: "player" }, this.button, speed, this.slider, this.told);
    }

    /** Space plays; left and right move by 0.1 s, with shift by 1 s. Fields that use these keys keep them.
     * @param {AbortSignal} [until] */
    keys(until) {
      document.addEventListener("keydown", (event) => {
        if (event.ctrlKey || event.altKey || event.metaKey) return;
        const at = /** @type {any} */ (event.target);
        const ours = at === this.slider;
        if (!ours && at.closest?.("input, select, textarea, [contenteditable]")) return;
        if (event.key === " " && !at.closest?.("button, a, summary")) this.toggle();
        else if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
          this.set(this.time + (event.key === "ArrowLeft" ? -1 : 1) * (event.shiftKey ? 1 : 0.1));
        } else return;
        event.preventDefault();
      }, { signal: until });
    }
  }
  P.Player = Player;

  /** Number of the last of rising times that is not after a moment; 0 before the first.
   * @param {ArrayLike<number>} times @param {number} time */
  P.before = (times, time) => {
    let low = 0;
    let high = times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (times[middle] <= time) low = middle;
      else high = middle - 1;
    }
    return low;
  };
})();

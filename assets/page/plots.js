// @ts-check
"use strict";
// Plots over time by uPlot with one cursor, each with a table for those who do not see it; and the strip under the slider of time.
(() => {
  const P = (globalThis.Propwash ??= {});

  /** Rows of the table under a plot. */
  const ROWS = 40;

  /** Plots over time that follow a player. A click sets its time.
   * @param {any} player
   * @param {{title: string, unit: string, t: ArrayLike<number>, series: {name: string, role: string, y: ArrayLike<number>, dash?: number[]}[],
   *   height?: number}[]} list `role` names a colour of the style sheet
   * @returns {{element: HTMLElement, set(list: any[]): void}} */
  P.timePlots = (player, list) => {
    const element = P.el("div", { class: "plots" });
    /** @type {any[]} */
    let made = [];
    const key = "propwash" + Math.random();

    /** @param {any} spec */
    function one(spec) {
      const at = P.el("div", { class: "plot" });
      const caption = P.el("figcaption", {}, spec.title + (spec.unit ? ", " + spec.unit : ""));
      const names = spec.series.length > 1 ? legend(spec.series) : "";
      const figure = P.el("figure", {}, caption, names, at, table(spec));
      element.append(figure);
      const axis = () => ({ stroke: P.color("soft"), grid: { stroke: P.color("grid"), width: 1 }, ticks: { show: false } });
      /** @param {any} u */
      const mark = (u) => {
        const x = u.valToPos(player.time, "x", true);
        u.ctx.fillStyle = P.color("mark");
        u.ctx.fillRect(x - devicePixelRatio, u.bbox.top, 2 * devicePixelRatio, u.bbox.height);
      };
      const height = spec.height ?? 150;
      const options = {
        width: Math.max(at.clientWidth, 200), height, legend: { show: false },
        cursor: { sync: { key, setSeries: false }, y: false, drag: { x: true, y: false } },
        scales: { x: { time: false } },
        axes: [{ ...axis(), size: 34 }, { ...axis(), size: 56 }],
        series: [{}, ...spec.series.map((/** @type {any} */ s) => ({
          label: s.name, stroke: () => P.color(s.role), width: 1.5, dash: s.dash, points: { show: false }, spanGaps: false,
        }))],
        hooks: { draw: [mark] },
      };
      options.axes.forEach((a, k) => {
        a.stroke = /** @type {any} */ (() => P.color("soft"));
        a.grid = { ...a.grid, stroke: /** @type {any} */ (() => P.color("grid")) };
      });
      const values = spec.series.map((/** @type {any} */ s) => Array.from(s.y, (v) => (Number.isFinite(v) ? v : null)));
      const plot = new uPlot(options, [Array.from(spec.t), ...values], at);
      plot.root.setAttribute("aria-hidden", "true");
      plot.over.addEventListener("click", (/** @type {MouseEvent} */ event) => {
        player.set(plot.posToVal(event.offsetX, "x"));
      });
      made.push({ plot, at, height });
    }

    /** @param {any[]} next */
    function set(next) {
      made.forEach((m) => m.plot.destroy());
      made = [];
      element.replaceChildren();
      next.forEach(one);
      // Each plot was made before those beside it, which leave it less room.
      resize();
    }
    const resize = () => made.forEach((m) => m.plot.setSize({ width: Math.max(m.at.clientWidth, 200), height: m.height }));
    new ResizeObserver(resize).observe(element);
    // Plots are made once they stand in the page and have a width.
    queueMicrotask(() => {
      set(list);
      P.onTheme(() => made.forEach((m) => m.plot.redraw(false)));
      player.on(() => made.forEach((m) => m.plot.redraw(false, false)));
    });
    return { element, set };
  };

  /** @param {any[]} series */
  function legend(series) {
    const entries = series.map((s) => {
      const line = P.el("i", { class: s.dash ? "dashed" : "" });
      line.style.setProperty("--role", `var(--${s.role})`);
      return P.el("li", {}, line, s.name);
    });
    return P.el("ul", { class: "legend" }, ...entries);
  }

  /** The same numbers behind a button, thinned. @param {any} spec */
  function table(spec) {
    return P.twin(spec.title, () => {
      const head = ["t, s", ...spec.series.map((/** @type {any} */ s) => s.name + (spec.unit ? ", " + spec.unit : ""))];
      const line = (/** @type {number} */ k) => [spec.t[k].toFixed(2), ...spec.series.map((/** @type {any} */ s) => P.number(s.y[k]))];
      return [head, ...P.every(spec.t.length, ROWS).map(line)];
    });
  }

  /** A strip of colours over the time of a player; a click jumps there.
   * @param {any} player @param {{label: string, share: (time: number) => number, ticks?: () => number[]}} spec `share` from 0 to 1 colours a
   *   moment by cividis; `ticks` are moments that get a line
   * @returns {{element: HTMLElement, draw(): void}} */
  P.strip = (player, spec) => {
    const canvas = P.el("canvas", { class: "strip", role: "img", "aria-label": spec.label });
    const base = document.createElement("canvas");
    const cursor = () => {
      const pen = canvas.getContext("2d");
      if (!base.width) return;
      pen.drawImage(base, 0, 0);
      pen.fillStyle = P.color("mark");
      const at = ((player.time - player.from) / Math.max(player.to - player.from, 1e-9)) * canvas.width;
      pen.fillRect(at - devicePixelRatio, 0, 2 * devicePixelRatio, canvas.height);
    };
    const draw = () => {
      const width = Math.max(1, Math.round(canvas.clientWidth * devicePixelRatio));
      const height = Math.max(1, Math.round(canvas.clientHeight * devicePixelRatio));
      [canvas.width, canvas.height, base.width, base.height] = [width, height, width, height];
      const pen = /** @type {CanvasRenderingContext2D} */ (base.getContext("2d"));
      const span = player.to - player.from;
      for (let x = 0; x < width; x++) {
        pen.fillStyle = P.css(P.cividis(spec.share(player.from + ((x + 0.5) / width) * span)));
        pen.fillRect(x, 0, 1, height);
      }
      pen.fillStyle = P.color("ink");
      for (const t of spec.ticks?.() ?? []) {
        pen.fillRect(((t - player.from) / Math.max(span, 1e-9)) * width, height * 0.7, devicePixelRatio, height * 0.3);
      }
      cursor();
    };
    const jump = (/** @type {PointerEvent} */ event) => {
      const box = canvas.getBoundingClientRect();
      player.set(player.from + ((event.clientX - box.left) / box.width) * (player.to - player.from));
    };
    canvas.addEventListener("pointerdown", (/** @type {PointerEvent} */ event) => {
      canvas.setPointerCapture(event.pointerId);
      jump(event);
    });
    canvas.addEventListener("pointermove", (/** @type {PointerEvent} */ event) => event.buttons && jump(event));
    new ResizeObserver(draw).observe(canvas);
    player.on(cursor);
    P.onTheme(draw);
    return { element: canvas, draw };
  };
})();

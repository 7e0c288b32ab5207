// @ts-check
"use strict";
// A depth image and the geoms in it, side by side: yellow is near; point at a pixel for its distance and geom.
(() => {
  const P = (globalThis.Propwash ??= {});
  const NOTHING = [0.08, 0.08, 0.1];

  /** A colour for each geom, far from that of its neighbours. @param {number} id */
  function colorOf(id) {
    const hue = (id * 137.508) % 360;
    const k = (/** @type {number} */ n) => (n + hue / 30) % 12;
    const part = (/** @type {number} */ n) => 0.55 - 0.35 * Math.max(-1, Math.min(k(n) - 3, Math.min(9 - k(n), 1)));
    return [part(0), part(8), part(4)];
  }

  class DepthImages {
    /** @param {{label: (geom: number) => string, light: (geom: number | null) => void}} scene names of geoms, and what lights one up */
    constructor(scene) {
      this.scene = scene;
      this.depth = P.el("canvas", { class: "image", role: "img", "aria-label": "depth image" });
      this.labels = P.el("canvas", { class: "image", role: "img", "aria-label": "geoms in the image" });
      this.readout = P.el("p", { role: "status", class: "readout" }, "Point at a pixel: distance and geom.");
      this.told = P.el("p", { class: "small" });
      const figure = (/** @type {string} */ name, /** @type {Node} */ of) => P.el("figure", {}, P.el("figcaption", {}, name), of);
      this.element = P.el("div", {}, P.el("div", { class: "images" }, figure("Depth", this.depth), figure("Geoms", this.labels)), this.readout, this.told);
      /** @type {any} */
      this.image = null;
      for (const canvas of [this.depth, this.labels]) {
        const point = (/** @type {PointerEvent} */ event) => this.point(canvas, event);
        canvas.addEventListener("pointermove", point);
        canvas.addEventListener("pointerdown", point);
        canvas.addEventListener("pointerleave", () => scene.light(null));
      }
    }

    /** Shows an image: distances in m (NaN where there is none), numbers of geoms (−1 none) and what stands in place of a distance, row by
     * row. @param {{width: number, height: number, far: number, metres: (k: number) => number, geom: (k: number) => number,
     * missing: (k: number) => string, told: (range: string) => string}} image */
    show(image) {
      this.image = image;
      const count = image.width * image.height;
      let range = 0.1;
      for (let k = 0; k < count; k++) if (image.metres(k) > range) range = image.metres(k);
      range = Math.min(image.far, range);
      this.fill(this.depth, (k) => {
        const distance = image.metres(k);
        return Number.isFinite(distance) ? P.cividis(1 - distance / range) : NOTHING;
      });
      this.fill(this.labels, (k) => (image.geom(k) >= 0 ? colorOf(image.geom(k) + 1) : NOTHING));
      this.told.textContent = image.told(P.number(range, "m"));
    }

    /** @param {any} canvas @param {(k: number) => number[]} rgb */
    fill(canvas, rgb) {
      const { width, height } = this.image;
      [canvas.width, canvas.height] = [width, height];
      const pen = canvas.getContext("2d");
      const out = pen.createImageData(width, height);
      for (let k = 0; k < width * height; k++) {
        const c = rgb(k);
        for (let n = 0; n < 3; n++) out.data[4 * k + n] = 255 * c[n];
        out.data[4 * k + 3] = 255;
      }
      pen.putImageData(out, 0, 0);
    }

    /** What a pixel says. @param {number} row @param {number} column */
    pixel(row, column) {
      const k = row * this.image.width + column;
      const distance = this.image.metres(k);
      const geom = this.image.geom(k);
      const found = Number.isFinite(distance) ? distance.toFixed(3) + " m" : this.image.missing(k);
      return { distance, geom, text: `row ${row}, column ${column}: ${found}` + (geom >= 0 ? `, ${this.scene.label(geom)}` : "") };
    }

    /** @param {any} canvas @param {PointerEvent} event */
    point(canvas, event) {
      if (!this.image) return;
      const box = canvas.getBoundingClientRect();
      const place = (/** @type {number} */ at, /** @type {number} */ size, /** @type {number} */ of) => Math.min(of - 1, Math.max(0, Math.floor((at / size) * of)));
      const found = this.pixel(place(event.clientY - box.top, box.height, this.image.height), place(event.clientX - box.left, box.width, this.image.width));
      this.readout.textContent = found.text;
      this.scene.light(found.geom >= 0 ? found.geom : null);
    }
  }
  P.DepthImages = DepthImages;
})();

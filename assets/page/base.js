// @ts-check
"use strict";
// What all pages share: data out of the page, elements, colours, the theme, and what stands behind the `#` of the address.
(() => {
  const P = (globalThis.Propwash ??= {});

  /** The data that the page carries under a name.
   * @param {string} id @returns {any} */
  P.json = (id) => JSON.parse(document.getElementById(id)?.textContent ?? "null");

  /** @param {string} text @returns {Uint8Array} */
  function bytes(text) {
    const held = atob(text);
    const out = new Uint8Array(held.length);
    for (let k = 0; k < held.length; k++) out[k] = held.charCodeAt(k);
    return out;
  }

  const NOTHING = -32768;

  /** Numbers out of little-endian bytes. 16-bit ones are `offset + scale * n`; the least one means that there is no value.
   * @param {{of: string, scale?: number, offset?: number}} spec @param {Uint8Array} raw @returns {any} */
  function numbers(spec, raw) {
    const view = new DataView(raw.buffer, raw.byteOffset, raw.byteLength);
    if (spec.of === "u8") return raw;
    if (spec.of === "u32") return Uint32Array.from({ length: raw.length / 4 }, (_, k) => view.getUint32(4 * k, true));
    if (spec.of === "u16") return Uint16Array.from({ length: raw.length / 2 }, (_, k) => view.getUint16(2 * k, true));
    if (spec.of === "f32") return Float32Array.from({ length: raw.length / 4 }, (_, k) => view.getFloat32(4 * k, true));
    if (spec.of === "f64") return Float64Array.from({ length: raw.length / 8 }, (_, k) => view.getFloat64(8 * k, true));
    const out = new Float32Array(raw.length / 2);
    for (let k = 0; k < out.length; k++) {
      const n = view.getInt16(2 * k, true);
      out[k] = n === NOTHING ? NaN : (spec.offset ?? 0) + (spec.scale ?? 1) * n;
    }
    return out;
  }

  /** An array of the page's data that is not compressed.
   * @param {{of: string, base64: string, scale?: number, offset?: number}} spec @returns {any} */
  P.array = (spec) => numbers(spec, bytes(spec.base64));

  /** An array of the page's data, compressed (zlib) or not.
   * @param {{of: string, base64?: string, zlib?: string, scale?: number, offset?: number}} spec @returns {Promise<any>} */
  P.unpack = async (spec) => {
    if (spec.zlib === undefined) return numbers(spec, bytes(spec.base64 ?? ""));
    const stream = new Blob([/** @type {any} */ (bytes(spec.zlib))]).stream().pipeThrough(new DecompressionStream("deflate"));
    return numbers(spec, new Uint8Array(await new Response(stream).arrayBuffer()));
  };

  /** Rows of arrays that hold their components. @param {any[]} specs @returns {Promise<Float32Array>} */
  P.rows = async (specs) => {
    const parts = await Promise.all(specs.map(P.unpack));
    const out = new Float32Array(parts.length * parts[0].length);
    parts.forEach((part, c) => part.forEach((/** @type {number} */ v, /** @type {number} */ k) => (out[k * parts.length + c] = v)));
    return out;
  };

  /** An element. Text is text: what looks like a tag in it is shown, never read.
   * @param {string} tag @param {Record<string, any>} [set] attributes; functions under `on…` are listeners
   * @param {...(Node | string)} inside @returns {any} */
  P.el = (tag, set = {}, ...inside) => {
    const out = document.createElement(tag);
    for (const [name, value] of Object.entries(set)) {
      if (name.startsWith("on")) out.addEventListener(name.slice(2), value);
      else if (value === true) out.setAttribute(name, "");
      else if (value !== false && value !== null && value !== undefined) out.setAttribute(name, String(value));
    }
    out.append(...inside);
    return out;
  };

  /** A table behind a button, filled when it is opened and by its function `fill`. `rows` gives the head and then the lines.
   * @param {string} title @param {() => any[][]} rows @returns {any} */
  P.twin = (title, rows) => {
    const details = P.el("details", { class: "numbers" }, P.el("summary", {}, "Table: " + title));
    const fill = () => {
      if (!details.open) return;
      const [head, ...lines] = rows();
      const body = lines.map((line) => P.el("tr", {}, ...line.map((/** @type {any} */ c) => P.el("td", {}, c))));
      const table = P.el("table", {}, P.el("thead", {}, P.el("tr", {}, ...head.map((/** @type {any} */ h) => P.el("th", { scope: "col" }, h)))),
        P.el("tbody", {}, ...body));
      details.querySelector(".scroll")?.remove();
      details.append(P.el("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Table: " + title }, table));
    };
    details.addEventListener("toggle", fill);
    details.fill = fill;
    return details;
  };

  /** Every so manieth of many lines, so that a table has at most so many. @param {number} n */
  P.every = (n, most = 60) => {
    const step = Math.max(1, Math.ceil(n / most));
    return Array.from({ length: Math.ceil(n / step) }, (_, k) => k * step);
  };

  /** A number with so many significant digits, and its unit.
   * @param {number} value @param {string} [unit] @param {number} [digits] */
  P.number = (value, unit = "", digits = 3) => {
    if (!Number.isFinite(value)) return "–";
    const size = Math.abs(value);
    const places = size < 1e-12 ? 0 : Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
    return value.toFixed(Math.min(places, 6)).replace("-", "−") + (unit ? " " + unit : "");
  };

  /** A question that is asked again and again, such as at every key: while an answer is on its way only the newest question is kept, so that
   * answers never come in another order than the questions. @template Q @param {(question: Q) => Promise<any>} ask */
  P.newest = (ask) => {
    let busy = false;
    /** @type {Q[]} */
    let waiting = [];
    return async (/** @type {Q} */ question) => {
      waiting = [question];
      if (busy) return;
      busy = true;
      try {
        for (let now = waiting.pop(); now !== undefined; now = waiting.pop()) await ask(now);
      } finally {
        busy = false;
      }
    };
  };

  /** Whether the person asked for less motion. */
  P.still = () => matchMedia("(prefers-reduced-motion: reduce)").matches;

  /** A colour of the style sheet, by the name of its variable. @param {string} name @returns {string} */
  P.color = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();

  // Nine steps of cividis (Nuñez, Anderton, Renslow 2018, doi 10.1371/journal.pone.0199239), which colour-blind people see alike.
  const STOPS = ["00224e", "123570", "3b496c", "575d6d", "707173", "8a8678", "a59c74", "c3b369", "e1cc55", "fee838"]
    .map((hex) => [0, 2, 4].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255));

  /** Red, green and blue (0 to 1, sRGB) of a share from 0 (dark blue) to 1 (yellow); grey where there is no value.
   * @param {number} share @returns {[number, number, number]} */
  P.cividis = (share) => {
    if (!Number.isFinite(share)) return [0.5, 0.5, 0.5];
    const at = Math.min(Math.max(share, 0), 1) * (STOPS.length - 1);
    const k = Math.min(Math.floor(at), STOPS.length - 2);
    return /** @type {[number, number, number]} */ ([0, 1, 2].map((c) => STOPS[k][c] + (at - k) * (STOPS[k + 1][c] - STOPS[k][c])));
  };

  /** @param {[number, number, number]} rgb */
  P.css = (rgb) => `rgb(${rgb.map((c) => Math.round(255 * c)).join(" ")})`;

  /** @type {(() => void)[]} */
  const themed = [];
  /** Calls a function now and whenever the theme changes. @param {() => void} then */
  P.onTheme = (then) => {
    themed.push(then);
    then();
  };
  /** Remembers who is called now; what is given back forgets everybody who came later. */
  P.themes = () => {
    const known = themed.length;
    return () => void themed.splice(known);
  };
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const isDark = () => (document.documentElement.dataset.theme ?? (dark.matches ? "dark" : "light")) === "dark";
  const changed = () => themed.forEach((then) => then());
  dark.addEventListener("change", changed);

  /** A button that turns the theme; the first one follows the system. */
  P.themeButton = () => {
    const button = P.el("button", { type: "button", class: "theme" });
    const name = () => (button.textContent = isDark() ? "Light" : "Dark");
    button.addEventListener("click", () => {
      document.documentElement.dataset.theme = isDark() ? "light" : "dark";
      name();
      changed();
    });
    dark.addEventListener("change", name);
    name();
    button.setAttribute("title", "Light or dark page");
    return button;
  };

  /** What stands behind the `#` of the address, as names and values. @returns {URLSearchParams} */
  P.fragment = () => new URLSearchParams(location.hash.slice(1));

  /** A button that copies the address of this page with names and values behind its `#`.
   * @param {() => Record<string, string>} now */
  P.linkButton = (now) => {
    const button = P.el("button", { type: "button" }, "Copy link to this moment");
    const told = P.el("span", { role: "status", class: "told" });
    button.addEventListener("click", async () => {
      const address = new URL(location.href);
      address.hash = new URLSearchParams(now()).toString();
      try {
        history.replaceState(null, "", address);
      } catch {
        // A page inside another one, as in a notebook, has no address of its own.
      }
      try {
        await navigator.clipboard.writeText(address.href);
        told.textContent = "copied";
      } catch {
        told.textContent = "the address bar has it";
      }
      setTimeout(() => (told.textContent = ""), 3000);
    });
    return P.el("span", { class: "link" }, button, told);
  };
})();

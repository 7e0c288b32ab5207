// @ts-check
"use strict";
// What the checker says of each log, whether it can be used, and what it is used for.
(() => {
  const P = (globalThis.Propwash ??= {});
  const lab = P.lab;

  const VERDICTS = {
    info: ["✓ usable", "sure"], warning: ["✓ usable, with warnings", "doubt"], refuse: ["✗ cannot be right", "bad"], fault: ["✗ cannot be read", "bad"], "not yet": ["…", ""],
  };

  /** Answers of the two questions that show a wrong unit or frame. @param {any[]} list */
  lab.sane = (list) => P.el("ul", { class: "sane" }, ...list.map((s) => P.el("li", { class: s.fine === null ? "open" : s.fine ? "fine" : "wrong" },
    P.el("span", { class: "mark", "aria-hidden": "true" }, s.fine === null ? "·" : s.fine ? "✓" : "✗"), " ", P.el("b", {}, s.title), ` ${s.words}`,
    s.fine === false ? P.el("span", {}, " (as it should not be)") : "")));

  /** @param {any[]} findings */
  lab.findings = (findings) => {
    const words = { refuse: "wrong", warning: "warning", info: "note" };
    const line = (/** @type {any} */ f) => P.el("li", { class: f.severity }, P.el("b", {}, /** @type {any} */ (words)[f.severity]), ": ", f.text);
    const grave = findings.filter((f) => f.severity !== "info");
    const notes = findings.filter((f) => f.severity === "info");
    return P.el("div", {}, grave.length ? P.el("ul", { class: "findings" }, ...grave.map(line)) : "",
      notes.length ? P.el("details", {}, P.el("summary", {}, `${notes.length} ${notes.length === 1 ? "note" : "notes"}`), P.el("ul", { class: "findings" }, ...notes.map(line))) : "");
  };

  /** The flight as a bar, with what is left out of it. @param {any} log */
  function bar(log) {
    const W = 600;
    const at = (/** @type {number} */ t) => Math.max(0, Math.min(W, (W * t) / Math.max(log.duration_s, 1e-9)));
    const words = log.excluded.length ? `${log.excluded.length} stretches are left out` : "all of it can be used";
    const parts = log.excluded.map((/** @type {any} */ e) => P.svg("rect", { x: at(e.from_s), y: 0, width: Math.max(2, at(e.to_s) - at(e.from_s)), height: 12, class: "out" },
      P.svg("title", {}, `${e.from_s.toFixed(2)} to ${e.to_s.toFixed(2)} s: ${String(e.reason).replaceAll("-", " ").replaceAll("_", " ")}`)));
    return P.el("div", { class: "used-bar" },
      P.svg("svg", { viewBox: `0 0 ${W} 12`, preserveAspectRatio: "none", role: "img", "aria-label": words }, P.svg("rect", { x: 0, y: 0, width: W, height: 12, class: "in" }), ...parts),
      P.el("span", { class: "small" }, `${log.duration_s.toFixed(1)} s, ${words}`));
  }

  /** @param {any} log */
  function channels(log) {
    const row = (/** @type {any} */ c) => P.el("tr", {}, P.el("td", { "data-label": "channel" }, c.name),
      P.el("td", { class: "n", "data-label": "samples per s" }, c.rate_hz ? c.rate_hz.toFixed(0) + " Hz" : "–"),
      P.el("td", { class: "n", "data-label": "longest gap" }, c.largest_gap_s ? (1000 * c.largest_gap_s).toFixed(0) + " ms" : "–"),
      P.el("td", { class: "n", "data-label": "samples" }, c.samples));
    const head = ["channel", "samples per s", "longest gap", "samples"].map((h, k) => P.el("th", { scope: "col", class: k ? "n" : "" }, h));
    return P.el("details", {}, P.el("summary", {}, `${log.channels.length} channels were measured`),
      P.el("table", { class: "stack" }, P.el("thead", {}, P.el("tr", {}, ...head)), P.el("tbody", {}, ...log.channels.map(row))));
  }

  /** @param {any} log */
  function uses(log) {
    const one = (/** @type {string} */ value, /** @type {string} */ words) => {
      const input = P.el("input", { type: "radio", name: `use ${log.id}`, value, checked: log.used === value });
      input.addEventListener("change", () => lab.tried(() => lab.act("use", { log: log.id, used: value }).then(() => P.show())));
      return P.el("label", { class: "ghost" }, input, words);
    };
    return P.el("fieldset", { class: "uses" }, P.el("legend", {}, "Use"), one("fit", "for the fit"), one("check", "to check only (held out)"));
  }

  /** @param {any} log */
  function card(log) {
    const [words, tag] = /** @type {any} */ (VERDICTS)[log.verdict];
    const fault = log.verdict === "fault";
    const tools = P.el("div", { class: "buttons" },
      log.mappable && (fault || !log.usable || log.mapped)
        ? lab.button("Name the columns", () => P.go(`map=${log.id}`), { class: log.usable ? "" : "main", "aria-label": `Name the columns of ${log.name}` }) : "",
      lab.button("Take out", () => lab.act("remove", { log: log.id }).then(() => P.show()), { "aria-label": `Take out ${log.name}` }));
    return P.el("section", { class: "card log", "aria-label": log.name },
      P.el("h3", {}, log.name, " ", P.el("span", { class: `tag ${tag}` }, words)),
      fault ? P.el("p", {}, log.words) : P.el("div", {}, bar(log), lab.sane(log.sane), lab.findings(log.findings), channels(log), log.usable ? uses(log) : ""),
      tools);
  }

  P.screens ??= {};
  P.screens.check = {
    title: "Check",
    async render(/** @type {HTMLElement} */ root) {
      await lab.refresh();
      const state = lab.state;
      if (!state?.logs.length) return P.go("start");
      const example = state.example ? P.el("p", { class: "note" }, "This flight was made by the simulator: an example, no measurement.") : "";
      root.append(P.el("h2", {}, "Can the logs be right?"), example, ...state.logs.map(card),
        P.el("div", { class: "choices" }, lab.vehicleChoice(), lab.sceneChoice(), lab.onward?.(state) ?? ""));
    },
  };
})();

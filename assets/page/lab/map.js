// @ts-check
"use strict";
// Foreign columns get our names, units and signs; two checks answer at once whether they can be right.
(() => {
  const P = (globalThis.Propwash ??= {});
  const lab = P.lab;

  const GROUPS = [
    ["time", ["t"]], ["position", ["px", "py", "pz"]], ["attitude as angles", ["roll", "pitch", "yaw"]], ["attitude as a quaternion", ["qx", "qy", "qz", "qw"]],
    ["velocity", ["vx", "vy", "vz"]], ["body rates (gyroscope)", ["wx", "wy", "wz"]], ["accelerometer", ["ax", "ay", "az"]],
    ["measured rotor speeds", /^rotor\d+$/], ["commanded rotor speeds", /^cmd_rotor\d+$/], ["throttle", /^cmd_u\d+$/],
    ["thrust and commands", ["thrust", "cmd_thrust", "cmd_roll", "cmd_pitch", "cmd_yaw"]], ["battery, wind", ["vbat", "wind_x", "wind_y", "wind_z"]],
    ["references", /^ref_/],
  ];
  const ANGLES = ["roll", "pitch", "yaw"];

  /** A small line of a column's numbers. @param {number[]} list */
  function preview(list) {
    const [low, high] = [Math.min(...list), Math.max(...list)];
    const y = (/** @type {number} */ v) => 22 - (20 * (v - low)) / Math.max(high - low, 1e-30);
    const points = list.map((v, k) => `${((120 * k) / Math.max(list.length - 1, 1)).toFixed(1)},${y(v).toFixed(1)}`).join(" ");
    return P.svg("svg", { viewBox: "0 0 120 24", class: "spark", "aria-hidden": "true" }, P.svg("polyline", { points }));
  }

  /** @param {any} given what the server says of the file @param {number} id */
  function screen(given, id) {
    const names = [...ANGLES, ...given.contract.map((/** @type {any} */ c) => c.name)];
    const units = (/** @type {string} */ ours) => ANGLES.includes(ours) ? ["rad", "deg", "mrad"] : (given.contract.find((/** @type {any} */ c) => c.name === ours)?.units ?? []);
    const rows = given.seen.columns.filter((/** @type {any} */ c) => c.numbers).map((/** @type {any} */ column) => {
      const chosen = given.choice.rows.find((/** @type {any} */ r) => r.from === column.name);
      return { column, ours: chosen?.ours ?? "", unit: chosen?.unit ?? "", negative: chosen?.negative ?? false };
    });
    const frames = { world_frame: "z_up", body_frame: "flu" };
    const choice = () => ({
      rows: rows.filter((/** @type {any} */ r) => r.ours).map((/** @type {any} */ r) => ({ from: r.column.name, ours: r.ours, unit: r.unit, negative: r.negative })),
      ...frames, delimiter: given.choice.delimiter ?? null,
    });
    const verdict = P.el("div", { id: "verdict", role: "status" }, P.el("p", { class: "small" }, "reading …"));
    let good = false;
    let text = "";
    const keep = lab.button("Use this mapping", async () => {
      await lab.act("map", { log: id, choice: choice(), keep: true });
      P.go("check");
    }, { class: "main" });
    const save = lab.button("Save as mapping file", () => P.download(given.name.replace(/\.[^.]*$/, "") + ".toml", text));
    async function check() {
      try {
        const told = await lab.act("map", { log: id, choice: choice() });
        if (told === undefined) return;
        good = true;
        text = told.text;
        const refused = told.report.verdict === "refuse";
        verdict.replaceChildren(
          P.el("p", {}, P.el("b", {}, refused ? "✗ With these names the log cannot be right" : "✓ The log can be read"), ` (${told.report.duration_s.toFixed(1)} s)`),
          lab.sane(told.sane), lab.findings(told.report.findings));
      } catch (error) {
        good = false;
        verdict.replaceChildren(P.el("p", { class: "said bad" }, /** @type {Error} */ (error).message));
      }
      buttons.hidden = !good;
    }
    const buttons = P.el("div", { class: "buttons", hidden: true }, keep, save);

    function line(/** @type {any} */ row) {
      const { column } = row;
      const ours = P.el("select", { "aria-label": `our name of ${column.name}` }, P.el("option", { value: "" }, "not used"), ...GROUPS.map(([title, list]) => {
        const own = names.filter((n) => (list instanceof RegExp ? list.test(n) : list.includes(n)));
        return P.el("optgroup", { label: title }, ...own.map((n) => P.el("option", { value: n, selected: n === row.ours }, n)));
      }));
      const unit = P.el("select", { "aria-label": `unit of ${column.name}` });
      const sign = P.el("select", { "aria-label": `sign of ${column.name}` }, P.el("option", { value: "+", selected: !row.negative }, "+"), P.el("option", { value: "-", selected: row.negative }, "−"));
      const fill = () => {
        const list = units(row.ours);
        if (!list.includes(row.unit)) row.unit = list[0] ?? "";
        unit.replaceChildren(...list.map((/** @type {string} */ u) => P.el("option", { value: u, selected: u === row.unit }, u === "1" ? "as it is" : u)));
        unit.hidden = !row.ours;
        sign.hidden = !row.ours;
        element.classList.toggle("is-on", Boolean(row.ours));
      };
      ours.addEventListener("change", () => {
        row.ours = ours.value;
        fill();
        check();
      });
      unit.addEventListener("change", () => {
        row.unit = unit.value;
        check();
      });
      sign.addEventListener("change", () => {
        row.negative = sign.value === "-";
        check();
      });
      const range = `${P.short(column.least)} … ${P.short(column.greatest)}`;
      const element = P.el("tr", {},
        P.el("td", { "data-label": "their column" }, P.el("code", {}, column.name)), P.el("td", { "data-label": "our name" }, ours),
        P.el("td", { "data-label": "unit" }, unit), P.el("td", { "data-label": "sign" }, sign), P.el("td", { class: "n", "data-label": "range" }, range), P.el("td", { "data-label": "preview" }, preview(column.preview)));
      fill();
      return element;
    }
    const frame = (/** @type {"world_frame" | "body_frame"} */ key, /** @type {string} */ title, /** @type {[string, string][]} */ options) => lab.choice(title, options, frames[key], (v) => {
      frames[key] = v;
      check();
    });
    const head = ["their column", "our name", "unit", "sign", "range", "preview"].map((h) => P.el("th", { scope: "col" }, h));
    check();
    return [
      P.el("h2", {}, "What do the columns of ", P.el("code", {}, given.name), " mean?"),
      P.el("p", { class: "lead" }, "Names and ranges suggest what is chosen here; correct what is wrong. World z is up, body x forward, y left, z up; the two checks tell whether units and frames can be right."),
      P.el("div", { class: "mapping" },
        P.el("table", { class: "stack map" }, P.el("thead", {}, P.el("tr", {}, ...head)), P.el("tbody", {}, ...rows.map(line))),
        P.el("aside", { class: "card checks", "aria-label": "Live checks" }, P.el("h3", {}, "Can it be right?"),
          P.el("div", { class: "choices" }, frame("world_frame", "World axes in the file", [["z_up", "z up (ENU, NWU)"], ["ned", "z down (NED)"], ["y_up", "y up"]]),
            frame("body_frame", "Body axes in the file", [["flu", "forward, left, up"], ["frd", "forward, right, down"]])),
          verdict, buttons, lab.button("Back", () => P.go("check")))),
    ];
  }

  P.screens ??= {};
  P.screens.map = {
    title: "Map",
    async render(/** @type {HTMLElement} */ root, /** @type {string} */ which) {
      await lab.refresh();
      const log = lab.state?.logs.find((/** @type {any} */ l) => String(l.id) === which);
      if (!log) return P.go("check");
      const given = await lab.act("columns", { log: log.id });
      root.append(...screen(given, log.id));
    },
  };
})();

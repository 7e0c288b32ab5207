// @ts-check
"use strict";
// What would change in the vehicle file, line by line, and where it is written. Nothing that is there already is replaced unasked.
(() => {
  const P = (globalThis.Propwash ??= {});
  const lab = P.lab;

  /** Lines with their signs; long stretches without a change are folded. @param {{kind: string, text: string}[]} lines */
  function diff(lines) {
    const near = (/** @type {number} */ k) => lines.slice(Math.max(0, k - 3), k + 4).some((l) => l.kind !== "kept");
    const out = [];
    let hidden = 0;
    const fold = () => {
      if (hidden) out.push(P.el("div", { class: "fold" }, `  ⋯ ${hidden} lines as they are`));
      hidden = 0;
    };
    lines.forEach((line, k) => {
      if (line.kind === "kept" && !near(k)) return hidden++;
      fold();
      const sign = line.kind === "added" ? "+" : line.kind === "removed" ? "−" : " ";
      const words = line.kind === "kept" ? "" : P.el("span", { class: "away" }, line.kind === "added" ? "added: " : "removed: ");
      out.push(P.el("div", { class: line.kind }, words, `${sign} ${line.text}`));
    });
    fold();
    return P.el("div", { class: "diff", tabindex: 0, role: "region", "aria-label": "Changes of the vehicle file" }, ...out);
  }

  /** @param {any} told */
  function form(told) {
    const folder = P.el("input", { type: "text", value: lab.start.folder, id: "folder", spellcheck: "false" });
    const rows = told.files.map((/** @type {any} */ f) => {
      const wanted = P.el("input", { type: "checkbox", checked: f.which === "vehicle" || f.which === "steps", "aria-label": `write ${f.title}` });
      const name = P.el("input", { type: "text", value: f.name, "aria-label": `name of ${f.title}`, spellcheck: "false" });
      const get = P.el("a", { href: `/api/sessions/${lab.id}/files/${f.which}`, download: f.name, "aria-label": `Download ${f.title}` }, "Download");
      return { f, wanted, name, cells: [wanted, P.el("label", {}, P.el("span", { class: "small" }, f.title), name), get] };
    });
    const done = P.el("div", { id: "saved", role: "status" });
    async function save(/** @type {boolean} */ replace) {
      const files = rows.filter((/** @type {any} */ r) => r.wanted.checked).map((/** @type {any} */ r) => ({ which: r.f.which, name: r.name.value }));
      try {
        const saved = await lab.act("save", { folder: folder.value, files, replace });
        if (saved === undefined) return;
        done.replaceChildren(P.el("p", { class: "note" }, "Saved: ", ...saved.written.flatMap((/** @type {string} */ path) => [P.el("code", {}, path), " "])), P.el("p", { class: "small" }, told.hint));
      } catch (error) {
        const there = /** @type {any} */ (error).data?.exists;
        if (!there) throw error;
        const no = lab.button("Keep them", () => done.replaceChildren(P.el("p", { class: "small" }, "Nothing was written.")));
        done.replaceChildren(P.el("div", { class: "note", role: "alert" }, P.el("p", {}, there.length === 1 ? "This file is there already: " : "These files are there already: ", P.el("code", {}, there.join(", "))),
          P.el("div", { class: "buttons" }, lab.button("Replace", () => save(true), { class: "main" }), no)));
        no.focus();
      }
    }
    return [P.el("label", { class: "folder" }, "Folder on this machine", folder), P.el("div", { class: "files" }, ...rows.flatMap((/** @type {any} */ r) => r.cells)),
      P.el("div", { class: "buttons" }, lab.button("Save", () => save(false), { class: "main" }), lab.button("Back to the flight", () => P.go("flight"))), done];
  }

  P.screens ??= {};
  P.screens.save = {
    title: "Save",
    async render(/** @type {HTMLElement} */ root) {
      await lab.refresh();
      if (!lab.state?.engine) return P.go("start");
      const told = await lab.act("preview");
      if (!told) return;
      const changes = told.diff.filter((/** @type {any} */ l) => l.kind !== "kept").length;
      root.append(P.el("h2", {}, "The better vehicle file"),
        P.el("p", { class: "lead" }, changes ? told.words : "No effect is on: the file stays as it is. Switch one on, or save what there is."),
        P.el("ul", { class: "legend" }, P.el("li", {}, P.el("ins", {}, "+ added")), P.el("li", {}, P.el("del", {}, "− removed"))), diff(told.diff), ...form(told));
    },
  };
})();

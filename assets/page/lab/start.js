// @ts-check
"use strict";
// The first screen: drop flight logs, or try an example that the program flies itself.
(() => {
  const P = (globalThis.Propwash ??= {});
  const lab = P.lab;

  const KINDS = ".csv,.txt,.parquet,.ulg,.ulog,.mcap,.toml,.xml";

  /** Takes files that were dropped or chosen. @param {Iterable<File>} files */
  async function take(files) {
    const list = [...files];
    if (!list.length) return;
    // A mapping belongs to a log that must be there first.
    list.sort((a, b) => Number(a.name.endsWith(".toml")) - Number(b.name.endsWith(".toml")));
    const refused = await lab.upload(list, (/** @type {string} */ words) => lab.tell(words));
    if (refused.length) lab.tell(refused.join(" · "), true);
    if (lab.state?.logs.length && refused.length < list.length) P.go("check");
    else P.show();
  }
  lab.take = take;

  function dropZone() {
    const input = P.el("input", { type: "file", multiple: true, accept: KINDS, id: "files", class: "away", "aria-label": "Choose flight logs" });
    input.addEventListener("change", () => lab.tried(() => take(input.files)));
    const zone = P.el("div", { class: "drop", id: "drop" },
      P.el("h2", {}, "Drop flight logs here"),
      P.el("p", { class: "small" }, ".csv, .parquet, .ulg or .mcap; with them a vehicle file (.toml), a mapping (.toml) or a scene (.xml)"),
      P.el("button", { type: "button", class: "main", onclick: () => input.click() }, "Choose files"), input);
    return zone;
  }

  /** @param {any} example */
  function card(example) {
    return P.el("div", { class: "card example" },
      P.el("h3", {}, example.title, " ", P.el("span", { class: "tag" }, "simulated example")),
      P.el("p", {}, example.about),
      lab.button("Try it", async () => {
        lab.tell(`flying “${example.title}” …`);
        // An example gets a session of its own: it is no part of somebody's work.
        if (lab.state?.logs.length) lab.use(null);
        await lab.act("example", { name: example.name });
        lab.tell("");
        P.go("check");
      }, { class: "main", "aria-label": `Try it: ${example.title}` }));
  }

  function sessions() {
    const list = lab.start.sessions;
    if (!list.length) return "";
    const row = (/** @type {any} */ s) => P.el("li", {}, P.el("span", {}, s.about), " ",
      lab.button("Go on", async () => {
        lab.use(String(s.id));
        await lab.refresh();
        P.go(lab.state?.logs.length ? "check" : "start");
      }, { "aria-label": `Go on with ${s.about}` }), " ",
      lab.button("Close", async () => {
        await lab.call("DELETE", `/api/sessions/${s.id}`);
        if (lab.id === String(s.id)) lab.use(null);
        await lab.refresh();
        P.show();
      }, { "aria-label": `Close ${s.about}` }));
    return P.el("section", { "aria-label": "Open sessions" }, P.el("h2", {}, "Open sessions"),
      P.el("p", { class: "small" }, `At most ${lab.start.most_sessions}; what is not saved goes when one is closed.`),
      P.el("ul", { class: "sessions" }, ...list.map(row)));
  }

  P.screens ??= {};
  P.screens.start = {
    title: "Start",
    async render(/** @type {HTMLElement} */ root) {
      await lab.refresh();
      const begun = lab.state?.logs.length;
      root.append(
        P.el("p", { class: "lead" }, "From a flight log to a better vehicle file: see the flight, see where the model fails, find which effect is missing, switch it on and watch the error fall. Nothing leaves this machine."),
        dropZone(),
        P.el("div", { class: "choices" }, lab.vehicleChoice(), lab.sceneChoice(),
          begun ? lab.button("Continue", () => P.go("check"), { class: "main" }) : ""),
        P.el("h2", {}, "No log at hand?"),
        P.el("p", { class: "small" }, "Each of these was flown by the simulator with one effect that its vehicle file does not have. They show how the lab works; they prove nothing about real flights."),
        P.el("div", { class: "cards" }, ...lab.start.examples.map(card)),
        sessions(),
      );
    },
  };

  // Files may be dropped anywhere on the page.
  document.addEventListener("dragover", (event) => {
    event.preventDefault();
    document.body.classList.add("dragging");
  });
  document.addEventListener("dragleave", (event) => event.relatedTarget === null && document.body.classList.remove("dragging"));
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    document.body.classList.remove("dragging");
    lab.tried(() => take(event.dataTransfer?.files ?? []));
  });
})();

// @ts-check
"use strict";
// The flight, the search for what its model lacks, the switches and sliders with the engine behind them, own expressions, and the steps so far.
(() => {
  const P = (globalThis.Propwash ??= {});
  const lab = P.lab;

  /** The living part that is shown, the data it was made of, and how often they were made anew. @type {any} */
  let living = null;
  /** @type {any} */
  let shown = null;
  const size = (/** @type {number} */ v, /** @type {string} */ unit) => {
    const scale = P.scaled(Math.abs(v), unit);
    return `${P.short(v * scale.factor)} ${scale.unit}`;
  };

  const MANUAL = [
    ["space", "play, pause"], ["← →", "0.1 s back, on; with shift 1 s"], ["[ ]", "window begins, ends at this moment"], ["1 – 9", "switch an effect"], ["U", "undo; with shift redo"],
    ["F", "follow the drone, or not"], ["G", "ghosts of the models, or none"], ["?", "this list"],
  ];
  const manual = P.el("dialog", { "aria-label": "Keys" }, P.el("h2", {}, "Keys"),
    P.el("dl", { class: "shortcuts" }, ...MANUAL.flatMap(([key, words]) => [P.el("dt", {}, key), P.el("dd", {}, words)])),
    P.el("form", { method: "dialog" }, P.el("button", { class: "main" }, "Close")));
  document.body.append(manual);

  // ----- the engine's values in the living part ------------------------------------------------------------------------------

  /** Shares of the way from the file to the estimate at which the engine has the effects that are on. @param {any} engine */
  function targets(engine) {
    const out = new Map();
    for (const e of living.effects) {
      const own = engine.effects.find((/** @type {any} */ x) => x.id === e.id);
      if (!own?.on) continue;
      out.set(e.id, e.handles.map((/** @type {any} */ _, /** @type {number} */ k) => own.shares[k] ?? 1));
    }
    return out;
  }

  /** How often the values or the question changed. */
  let asked = 0;

  /** Asks the engine for figures and residuals at its values; the newest question wins. */
  async function settle() {
    const mine = living;
    const turn = ++asked;
    let told;
    try {
      told = await lab.act("exact", { flight: mine.flight(), window: mine.window() });
    } catch (error) {
      // A window without held-out flight has the page's own figures alone.
      if (mine.window()) return tellExactness(false);
      throw error;
    }
    // The person has gone on since: these figures are of values that are no more.
    if (told === undefined || mine !== living || turn !== asked) return;
    const read = (/** @type {any} */ a) => (a ? P.array(a) : null);
    mine.settle({ force: told.force_n, torque: told.torque_n_m ?? undefined }, { force: read(told.arrays?.force), torque: read(told.arrays?.torque) });
    tellExactness(true);
    tellCompared(told.arrays?.rms, mine);
    renew();
  }

  const exactness = P.el("p", { class: "exactness", id: "exactness", role: "status" });
  function tellExactness(/** @type {boolean} */ exact) {
    exactness.textContent = exact ? "figures are those of the model itself" : "≈: a forecast, until the engine has answered";
  }

  const compared = P.el("p", { class: "small", id: "compared" });
  /** What `propwash compare` prints of a vehicle file with the present values. @param {any} rms @param {any} mine */
  function tellCompared(rms, mine) {
    compared.hidden = !rms || Boolean(mine.window());
    if (compared.hidden) return;
    const axes = (/** @type {number[]} */ list, /** @type {string} */ unit) => {
      const scale = P.scaled(Math.max(...list), unit);
      return list.map((v) => P.short(v * scale.factor)).join(", ") + " " + scale.unit;
    };
    const torque = rms.torque_n_m ? `; torque ${axes(rms.torque_n_m, "N·m")}` : "";
    compared.textContent = `Every instant of the flight, body x, y, z, as compare prints them: force ${axes(rms.force_n, "N")}${torque}.`;
    compared.dataset.si = JSON.stringify(rms);
  }

  /** After the engine has other values: they glide there, and the exact figures follow. */
  async function adopt() {
    if (!living) return;
    asked++;
    tellExactness(false);
    living.adopt(targets(lab.state.engine));
    renew();
    await settle();
  }

  /** The person turned a switch or moved a slider. @param {any} change */
  async function changed(change) {
    asked++;
    tellExactness(false);
    await lab.tried(async () => {
      if (change.kind === "switch") {
        if ((await lab.act("toggle", { effect: change.effect.id, on: change.effect.on })) === undefined) return;
        await adopt();
      } else if (change.kind === "all") {
        if ((await lab.act("only", { effects: change.effects.map((/** @type {any} */ e) => e.id) })) === undefined) return;
        await adopt();
      } else {
        const k = change.effect.handles.indexOf(change.handle);
        if ((await lab.act("set", { effect: change.effect.id, handle: k, share: change.effect.shares[k] })) === undefined) return;
        renew();
        await settle();
      }
    });
  }

  // ----- finding --------------------------------------------------------------------------------------------------------------

  const bar = P.el("progress", { max: 1, "aria-label": "progress" });
  const settling = P.el("ol", { class: "settling", "aria-label": "so far" });
  const working = P.el("div", { hidden: true }, P.el("p", { id: "doing", role: "status" }), bar,
    P.el("div", { class: "buttons" }, lab.button("Cancel", () => lab.post(`/api/sessions/${lab.id}/cancel`))), settling);
  lab.listeners.push((/** @type {any} */ news) => {
    const p = news.progress;
    if (!p) return;
    const words = working.querySelector("#doing");
    if (words && p.words) words.textContent = p.words;
    if (p.total) {
      bar.max = p.total;
      bar.value = p.done;
    }
    if (p.early) {
      settling.replaceChildren(...p.early.map((/** @type {any} */ e) => P.el("li", {}, P.el("code", {}, e.id), ` ${e.title ?? ""}${e.nats === null || e.nats === undefined ? "" : `, ${P.short(e.nats)} nats`}`)));
    }
  });

  /** Long work with progress and cancel. @param {string} verb @param {string} words @param {any} [body] */
  async function long(verb, words, body) {
    const begin = performance.now();
    const doing = /** @type {HTMLElement} */ (working.querySelector("#doing"));
    doing.textContent = words;
    bar.removeAttribute("value");
    settling.replaceChildren();
    working.hidden = false;
    try {
      const done = await lab.act(verb, body);
      if (done !== undefined) lab.tell(`${words.replace(/ …$/, "")}: done in ${((performance.now() - begin) / 1000).toFixed(1)} s`);
      return done;
    } finally {
      working.hidden = true;
    }
  }

  const head = P.el("div", {});
  const foot = P.el("div", {});

  const find = () => lab.button(lab.state.engine.searched ? "Search again" : "Find what is missing", async () => {
    await long("find", "Searching for what is missing …");
    await rebuild();
  }, { class: lab.state.engine.searched ? "" : "main" });

  /** What changes with the engine's state: above and below the effects. */
  function renew() {
    const engine = lab.state.engine;
    // Elements are made anew: what had the focus keeps it.
    const focused = document.activeElement instanceof HTMLButtonElement && (head.contains(document.activeElement) || foot.contains(document.activeElement)) ? document.activeElement.textContent : null;
    const stale = engine.stale ? P.el("p", { class: "note" }, "The logs are used otherwise than in the last fit. ", lab.button("Fit again", () => long("fit", "Fitting …").then(rebuilt))) : "";
    head.replaceChildren(P.el("div", { class: "find" }, ...(engine.searched
      ? [P.el("p", { class: "headline", id: "headline" }, engine.headline), engine.unexplained ? P.el("p", { class: "note" }, "Something remains unexplained: no effect of the list accounts for all that is missing.") : ""]
      : [P.el("p", { class: "headline" }, engine.headline), P.el("p", {}, "Which physical effect does the model lack? The search fits every candidate to the flight and says which ones the measurement asks for.")]),
    P.el("div", { class: "buttons" }, find()), working), stale);
    const on = engine.effects.filter((/** @type {any} */ e) => e.on).length;
    foot.replaceChildren(
      P.el("div", { class: "buttons", role: "group", "aria-label": "steps" },
        engine.searched && on ? lab.button("Fit the ones that are on", () => long("fit", "Fitting …").then(rebuilt)) : "",
        engine.can_undo ? lab.button("Undo", undo) : "", engine.can_redo ? lab.button("Redo", redo) : "",
        lab.button("Keys", () => manual.showModal()), on ? lab.button("Save …", () => P.go("save"), { class: "main" }) : ""),
      exactness, compared, steps(engine), own);
    if (focused) [...head.querySelectorAll("button"), ...foot.querySelectorAll("button")].find((b) => b.textContent === focused)?.focus({ preventScroll: true });
  }
  const undo = () => lab.act("undo").then(rebuilt);
  const redo = () => lab.act("redo").then(rebuilt);
  /** After a step back or on: other columns may belong to it. */
  const rebuilt = () => (lab.state.engine.columns === shown ? adopt() : rebuild());

  /** The steps so far, each with its figures; a click goes there. @param {any} engine */
  function steps(engine) {
    if (engine.history.length < 2) return "";
    const forceOf = (/** @type {any} */ s) => s.figures?.force_n ?? NaN;
    const most = Math.max(...engine.history.map(forceOf).filter(Number.isFinite), 1e-12);
    const current = engine.history.findIndex((/** @type {any} */ s) => s.current);
    const one = (/** @type {any} */ s, /** @type {number} */ k) => {
      const fill = P.el("i", { class: k ? "" : "first" });
      fill.style.width = `${Math.max(0.5, (100 * (forceOf(s) || 0)) / most)}%`;
      const about = s.exact ? "" : "≈ ";
      const torque = s.figures?.torque_n_m === null || s.figures?.torque_n_m === undefined ? "" : size(s.figures.torque_n_m, "N·m");
      const step = P.el("button", { type: "button", class: "rung", "aria-current": s.current ? "step" : null }, P.el("span", {}, s.what), P.el("div", {}, fill), P.el("span", {}, about + size(forceOf(s), "N")), P.el("span", {}, torque));
      step.addEventListener("click", () => lab.tried(() => lab.act("go", { step: s.number }).then(rebuilt)));
      return P.el("li", { class: k > current ? "later" : "" }, step);
    };
    return P.el("section", { "aria-label": "Steps so far" }, P.el("h3", {}, "Steps so far"),
      P.el("p", { class: "small" }, `Missing force and torque after each, on ${engine.judged_on}; a click goes there.`), P.el("ol", { class: "history" }, ...engine.history.map(one)));
  }

  // ----- own expressions ------------------------------------------------------------------------------------------------------

  const AXES = [["force_body_x", "force along body x"], ["force_body_y", "force along body y"], ["force_body_z", "force along body z"], ["torque_x", "torque about body x"], ["torque_y", "torque about body y"], ["torque_z", "torque about body z"]];
  const text = P.el("input", { type: "text", spellcheck: "false", autocomplete: "off", autocapitalize: "off", "aria-label": "expression", placeholder: "-k * vx_body * abs(vx_body)", "aria-describedby": "expression-said" });
  const said = P.el("pre", { id: "expression-said", role: "status" });
  const axis = P.el("select", { "aria-label": "acts as" }, ...AXES.map(([v, words]) => P.el("option", { value: v }, words)));
  const add = lab.button("Try it", async () => {
    await lab.act("expression", { axis: axis.value, text: text.value });
    text.value = "";
    said.textContent = "";
    add.hidden = true;
    await rebuild();
  }, { hidden: true });
  const ask = P.newest(async (/** @type {{axis: string, text: string}} */ asked) => {
    const told = await lab.tried(() => lab.act("try_expression", asked));
    // What was typed since then is asked next.
    if (!told || asked.text !== text.value || asked.axis !== axis.value) return;
    said.className = told.fine ? "" : "wrong";
    const under = told.column === null || told.column === undefined ? "" : `${asked.text}\n${" ".repeat(told.column)}^ `;
    said.textContent = under + told.words;
    add.hidden = !told.fine;
  });
  function judge() {
    add.hidden = true;
    if (!text.value.trim()) said.textContent = "";
    else ask({ axis: axis.value, text: text.value });
  }
  text.addEventListener("input", judge);
  axis.addEventListener("change", judge);
  const own = P.el("details", { class: "own" }, P.el("summary", {}, "An expression of your own"),
    P.el("p", { class: "small" }, "A formula that the force or torque may lack, SI, body axes. It is checked as you type, and becomes a candidate with a slider."),
    P.el("div", { class: "line" }, axis, text, add), said);

  // ----- the screen -----------------------------------------------------------------------------------------------------------

  let place = P.el("div", {});

  /** Makes the living part anew, of the data as they are now. */
  async function rebuild() {
    const [data, scene] = await Promise.all([lab.act("live"), lab.act("shapes")]);
    if (!data) return;
    asked++;
    tellExactness(false);
    const window_ = living?.window() ?? null;
    const time = living?.player.time;
    living?.end();
    living = null;
    shown = lab.state.engine.columns;
    const root = P.el("div", { id: "lab" });
    const times = P.el("div", {});
    const causes = P.el("div", {});
    place.replaceChildren(root, P.el("h2", {}, "What the model lacks, over time"),
      P.el("ul", { class: "legend" }, ...[["filed", "", "your model (before)"], ["found", "", "now, with the effects that are on"], ["mark", "block", "worst stretches"], ["soft", "block", "95 % of noise"]].map(([role, kind, words]) => {
        const line = P.el("i", { class: kind });
        line.style.setProperty("--role", `var(--${role})`);
        return P.el("li", {}, line, words);
      })), times, P.el("h2", {}, "What the error depends on"), causes);
    renew();
    living = P.living(data, { root, times, causes, scene: scene?.scene ?? null, head, foot, searched: lab.state.engine.searched, changed, windowed: () => living && lab.tried(settle) });
    living.adopt(targets(lab.state.engine));
    if (window_) living.setWindow(window_);
    if (time !== undefined) living.player.set(time);
    lab.living = living;
    await settle();
  }

  document.addEventListener("keydown", (event) => {
    if (!living || event.ctrlKey || event.metaKey || event.altKey || /** @type {any} */ (event.target).closest?.("input:not([type=range]):not([type=checkbox]), select, textarea")) return;
    if (event.key === "?") manual.showModal();
    else if (event.key.toLowerCase() === "u") {
      const engine = lab.state.engine;
      if (event.shiftKey ? engine.can_redo : engine.can_undo) lab.tried(event.shiftKey ? redo : undo);
    } else return;
    event.preventDefault();
  });
  document.addEventListener("keydown", (event) => {
    if (!living || !(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z" || /** @type {any} */ (event.target).closest?.("input[type=text]")) return;
    event.preventDefault();
    const engine = lab.state.engine;
    if (event.shiftKey ? engine.can_redo : engine.can_undo) lab.tried(event.shiftKey ? redo : undo);
  });

  /** The way from the check to the flight. @param {any} state */
  lab.onward = (state) => (state.waits_for ? P.el("p", { class: "note", role: "status" }, `Next: ${state.waits_for}.`) : lab.button("Continue", () => P.go("flight"), { class: "main" }));

  P.screens ??= {};
  P.screens.flight = {
    title: "Flight",
    async render(/** @type {HTMLElement} */ root) {
      await lab.refresh();
      if (!lab.state || lab.state.waits_for) return P.go(lab.state?.logs.length ? "check" : "start");
      if (!lab.state.engine) {
        lab.tell("comparing model and flight …");
        await lab.act("open");
        lab.tell("");
      }
      place = P.el("div", {});
      const names = lab.state.engine.flights.map((/** @type {any} */ f) => f.name).join(", ");
      root.append(P.el("h2", { class: "away" }, "Flight and effects"), P.el("p", { class: "small" }, `${lab.state.vehicle.label} × ${names}${lab.state.example ? " · example, made by the simulator" : ""}`), place);
    },
    /** Plots take their width from the page, so they are made when they stand in it. */
    shown: () => lab.tried(rebuild),
    left() {
      living?.end();
      living = lab.living = null;
    },
  };
})();

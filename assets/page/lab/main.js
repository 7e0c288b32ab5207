// @ts-check
"use strict";
// The steps of the lab: which screen is shown, by what stands behind the `#` of the address.
(() => {
  const P = (globalThis.Propwash ??= {});
  const lab = P.lab;
  const main = /** @type {HTMLElement} */ (document.getElementById("main"));
  const steps = /** @type {HTMLElement} */ (document.getElementById("steps"));
  /** Steps that one can go to from the bar, with what must be there. @type {[string, string, (s: any) => boolean][]} */
  const STEPS = (P.steps = [
    ["start", "Start", () => true],
    ["check", "Check", (s) => Boolean(s?.logs.length)],
    ["flight", "Flight and effects", (s) => Boolean(s?.logs.length && !s.waits_for)],
    ["next", "Next flight", (s) => Boolean(s?.engine?.effects.some((/** @type {any} */ e) => e.on || e.certain))],
    ["save", "Save", (s) => Boolean(s?.engine)],
  ]);

  /** Keeps a text as a file of the person. @param {string} name @param {string} text */
  P.download = (name, text) => {
    const link = P.el("a", { href: URL.createObjectURL(new Blob([text], { type: "text/plain" })), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  };

  const asked = () => {
    const [name, which] = location.hash.slice(1).split("=");
    return [P.screens[name] ? name : "start", which ?? ""];
  };

  function showSteps() {
    const [name] = asked();
    const current = name === "map" ? "check" : name;
    const inside = STEPS.map(([id, title, may], k) => {
      const words = `${k + 1} ${title}`;
      if (id === current) return P.el("a", { href: `#${id}`, "aria-current": "step" }, words);
      return may(lab.state) ? P.el("a", { href: `#${id}` }, words) : P.el("span", { class: "later" }, words);
    });
    steps.replaceChildren(...inside);
  }
  lab.followers.push(showSteps);

  let shown = 0;
  /** @type {any} */
  let screen = null;
  /** Shows the screen of the address anew. @param {boolean} [focus] whether it is another one, which gets the focus */
  P.show = async (focus = false) => {
    const turn = ++shown;
    const [name, which] = asked();
    const root = P.el("div", { class: `screen ${name}` });
    const next = P.screens[name];
    await lab.tried(() => next.render(root, which));
    // Another screen was asked for in the meantime.
    if (turn !== shown) return next.left?.(root);
    screen?.left?.();
    screen = next;
    main.replaceChildren(root);
    next.shown?.(root);
    document.title = `${next.title} · Propwash lab`;
    showSteps();
    if (focus) {
      main.focus({ preventScroll: true });
      scrollTo(0, 0);
    }
  };

  /** Goes to a screen. @param {string} name */
  P.go = (name) => {
    if (location.hash === "#" + name) P.show(true);
    else location.hash = name;
  };
  addEventListener("hashchange", () => P.show(true));

  (async () => {
    // The secret of the address is a cookie by now.
    history.replaceState(null, "", location.pathname + location.hash);
    await lab.tried(async () => {
      await lab.refresh();
      if (lab.id === null && lab.start.given) {
        await lab.session(true);
        await lab.refresh();
        if (lab.state?.logs.length && !location.hash) history.replaceState(null, "", "#check");
      }
    });
    await P.show();
    lab.ready = true;
  })();
})();

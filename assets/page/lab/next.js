// @ts-check
"use strict";
// What to fly next: the manoeuvre that would tell look-alikes apart, in the box that there is.
(() => {
  const P = (globalThis.Propwash ??= {});
  const lab = P.lab;
  /** @type {any} */
  let view = null;
  /** @type {AbortController | null} */
  let left = null;
  let forget = () => {};
  let box = [6, 6, 3];

  /** The path in three dimensions with a drone that flies it. @param {any} plan */
  function picture(plan) {
    const stage = P.el("div", { class: "stage" });
    const points = plan.waypoints;
    const t = Float64Array.from(points, (/** @type {any} */ p) => p[0]);
    const pos = Float32Array.from(points.flatMap((/** @type {any} */ p) => p.slice(1, 4)));
    const quat = Float32Array.from(points.flatMap((/** @type {any} */ p) => [0, 0, Math.sin(p[4] / 2), Math.cos(p[4] / 2)]));
    const player = new P.Player(t[0], t[t.length - 1]);
    const told = P.el("p", { class: "small told", role: "status" });
    forget = P.themes();
    try {
      view = new P.Scene3D({ label: "The path to fly in three dimensions; the text under it tells the moment" });
    } catch {
      stage.append(P.el("p", { class: "small" }, "This browser draws no 3-D (WebGL): the picture is left out; the waypoints are in the table."));
      return [stage];
    }
    stage.append(view.canvas);
    const size = Math.max(...plan.box_m);
    view.addGrid(Math.ceil(1.2 * size), [0, 0, 0]);
    view.addPath(pos, { width: 4, role: "found" });
    const corners = [-0.5, 0.5].flatMap((x) => [-0.5, 0.5].map((y) => [x * plan.box_m[0], y * plan.box_m[1]]));
    const edges = Float32Array.from([...corners.flatMap(([x, y]) => [x, y, 0, x, y, plan.box_m[2], NaN, NaN, NaN]),
      ...[0, plan.box_m[2]].flatMap((z) => [[0, 1], [1, 3], [3, 2], [2, 0]].flatMap(([a, b]) => [...corners[a], z, ...corners[b], z, NaN, NaN, NaN]))]);
    view.addPath(edges, { width: 1.5, role: "soft" });
    const drone = view.addDrone({ rotors: plan.rotors.length ? plan.rotors : [[0.1, 0, 0], [-0.1, 0, 0]] }, { role: "drone", halo: true });
    view.target = drone;
    const tools = P.el("div", { class: "flight-tools" }, view.viewButtons());
    view.frame([-plan.box_m[0] / 2, -plan.box_m[1] / 2, 0], [plan.box_m[0] / 2, plan.box_m[1] / 2, plan.box_m[2]]);
    left = new AbortController();
    player.keys(left.signal);
    const bar = player.controls();
    player.on((/** @type {number} */ time) => {
      const at = P.poseAt({ t, pos, quat }, time);
      drone.place(at.pos, at.quat);
      view.moved();
      const part = plan.manoeuvres.findLast((/** @type {any} */ m) => m.start_s <= time);
      if (!player.playing) told.textContent = `${time.toFixed(1)} s: ${part?.name ?? "on the way"}, at ${[...at.pos].map((v) => v.toFixed(1)).join(", ")} m`;
    });
    return [stage, tools, bar, told];
  }

  function end() {
    left?.abort();
    forget();
    forget = () => {};
    view?.end();
    view = left = null;
  }

  /** @param {HTMLElement} root @param {any} plan */
  function show(root, plan) {
    end();
    if (!plan.waypoints.length) return root.replaceChildren(P.el("p", { class: "note" }, plan.words));
    const row = (/** @type {any} */ m) => P.el("tr", {}, P.el("td", { "data-label": "manoeuvre" }, m.name), P.el("td", { "data-label": "what" }, m.title), P.el("td", { class: "n", "data-label": "from" }, m.start_s.toFixed(1) + " s"), P.el("td", { class: "n", "data-label": "for" }, m.duration_s.toFixed(1) + " s"));
    root.replaceChildren(P.el("p", {}, plan.words), P.el("div", { class: "next" }, ...picture(plan)),
      P.el("table", { class: "stack" }, P.el("thead", {}, P.el("tr", {}, ...["manoeuvre", "what", "from", "for"].map((h, k) => P.el("th", { scope: "col", class: k > 1 ? "n" : "" }, h)))), P.el("tbody", {}, ...plan.manoeuvres.map(row))),
      plan.expected.length ? P.el("ul", {}, ...plan.expected.map((/** @type {string} */ e) => P.el("li", {}, e))) : "",
      P.twin("waypoints", () => [["t, s", "x, m", "y, m", "z, m", "yaw, rad"], ...P.every(plan.waypoints.length).map((/** @type {number} */ k) => plan.waypoints[k].map((/** @type {number} */ v) => v.toFixed(2)))]),
      P.el("div", { class: "buttons" }, lab.button("Save the waypoints", () => P.download("waypoints.csv", plan.csv), { class: "main" })));
  }

  P.screens ??= {};
  P.screens.next = {
    title: "Next flight",
    async render(/** @type {HTMLElement} */ root) {
      await lab.refresh();
      if (!lab.state?.engine) return P.go("start");
      const place = P.el("div", { id: "plan" });
      const inputs = ["length", "width", "height"].map((name, k) => P.el("input", { type: "number", min: 1, max: 1000, step: 0.5, value: box[k], "aria-label": `${name} of the box, m` }));
      const plan = lab.button("Plan it", async () => {
        box = inputs.map((i) => Number(i.value));
        place.replaceChildren(P.el("p", { class: "small", role: "status" }, "flying the manoeuvres in simulation …"));
        try {
          const told = await lab.act("next", { box_m: box });
          if (told) show(place, told);
        } catch (error) {
          place.replaceChildren();
          throw error;
        }
      }, { class: "main" });
      root.append(P.el("h2", {}, "What to fly next"),
        P.el("p", { class: "lead" }, "Manoeuvres that show most of what this flight leaves open, flown by this vehicle's own controller in the room that you have."),
        P.el("div", { class: "window" }, "Box ", inputs[0], " × ", inputs[1], " × ", inputs[2], " m ", plan), place);
    },
    left: end,
  };
})();

// @ts-check
"use strict";
// What can be tried in a watched scene: a depth camera that flies by keys, and a path that a drone is to fly. The server answers with the
// simulator's own rays and checks.
(() => {
  const P = globalThis.Propwash;

  /** A camera's −z along the body's x, its upper edge up. */
  const FORWARD = [0.5, -0.5, -0.5, 0.5];
  const STEP_M = 0.1;
  const FAST = 5;
  const TURN_DEG = 5;
  /** Name, key, what it is called on the button, and the move: ahead, left, up (m); turn to the left and up (degrees). */
  const MOVES = /** @type {[string, string, string, number[]][]} */ ([
    ["ahead", "w", "Ahead", [1, 0, 0, 0, 0]], ["back", "s", "Back", [-1, 0, 0, 0, 0]], ["left", "a", "Left", [0, 1, 0, 0, 0]],
    ["right", "d", "Right", [0, -1, 0, 0, 0]], ["up", "e", "Up", [0, 0, 1, 0, 0]], ["down", "q", "Down", [0, 0, -1, 0, 0]],
    ["turn left", "arrowleft", "⟲", [0, 0, 0, 1, 0]], ["turn right", "arrowright", "⟳", [0, 0, 0, -1, 0]],
    ["look up", "arrowup", "Look up", [0, 0, 0, 0, 1]], ["look down", "arrowdown", "Look down", [0, 0, 0, 0, -1]],
  ]);
  const START = { x: 0, y: 0, z: 1, heading: 0, pitch: 0 };

  /** An answer of the server; what it says in words where it refuses. @param {string} what @param {[string, string][]} words */
  async function answer(what, words) {
    const query = words.map(([name, value]) => `${name}=${value}`).join("&");
    let response;
    try {
      response = await fetch(`/${what}?${query}`);
    } catch {
      throw new Error("The program has ended: start `propwash view … --watch` again.");
    }
    if (!response.ok) throw new Error(await response.text());
    return response;
  }

  /** @param {any} S what `view.js` shows */
  function start(S) {
    const { view, data, side, label } = S;
    const choices = data.probe;
    if (!choices || !data.scene) return;
    const state = { ...START };
    const flying = () => view.pilot !== null;

    // ----- the camera ---------------------------------------------------------------------------------------------------------

    const rig = new THREE.Group();
    const pyramid = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial());
    rig.add(pyramid);
    rig.visible = false;
    rig.userData = { there: true, reach: 0.08 };
    view.scene.add(rig);
    P.onTheme(() => pyramid.material.color.set(P.color("found")));

    const images = new P.DepthImages({ label, light: (/** @type {number | null} */ geom) => view.highlight(geom) });
    images.element.hidden = true;
    const device = P.el("select", {}, ...choices.devices.map((/** @type {any} */ d) => P.el("option", { value: d.name }, `${d.name}, ${d.width} × ${d.height}`)));
    const chosen = () => choices.devices.find((/** @type {any} */ d) => d.name === device.value);
    const told = P.el("p", { role: "status", class: "small" });
    const fields = Object.keys(START).map((name) => {
      const angle = name === "heading" || name === "pitch";
      const input = P.el("input", { type: "number", step: angle ? TURN_DEG : STEP_M, name });
      input.addEventListener("change", () => {
        const value = input.valueAsNumber;
        if (Number.isFinite(value)) set({ [name]: value });
        else input.value = rounded(/** @type {any} */ (state)[name]);
      });
      return { name, input, element: P.el("label", { class: "choice" }, P.el("span", {}, `${name}, ${angle ? "°" : "m"}`), input) };
    });
    const rounded = (/** @type {number} */ v) => String(Math.round(v * 1000) / 1000);

    /** Attitude of the body that carries the camera. */
    function attitude() {
      const turn = new THREE.Quaternion().setFromAxisAngle(new THREE.Vector3(0, 0, 1), (state.heading * Math.PI) / 180);
      return turn.multiply(new THREE.Quaternion().setFromAxisAngle(new THREE.Vector3(0, 1, 0), (-state.pitch * Math.PI) / 180));
    }

    /** @param {Partial<typeof START>} to */
    function set(to) {
      Object.assign(state, to);
      state.pitch = Math.min(90, Math.max(-90, state.pitch));
      state.heading = ((((state.heading + 180) % 360) + 360) % 360) - 180;
      for (const { name, input } of fields) input.value = rounded(/** @type {any} */ (state)[name]);
      rig.position.set(state.x, state.y, state.z);
      rig.quaternion.copy(attitude());
      view.moved();
      rig.visible = flying() && view.view !== "first person";
      if (flying()) ask({});
    }

    /** @param {number[]} move @param {number} times */
    function go([ahead, left, up, turn, tilt], times) {
      const heading = (state.heading * Math.PI) / 180;
      const step = STEP_M * times;
      set({
        x: state.x + step * (ahead * Math.cos(heading) - left * Math.sin(heading)),
        y: state.y + step * (ahead * Math.sin(heading) + left * Math.cos(heading)),
        z: state.z + step * up, heading: state.heading + TURN_DEG * times * turn, pitch: state.pitch + TURN_DEG * times * tilt,
      });
    }

    const ask = P.newest(async () => {
      const of = chosen();
      const turn = attitude().multiply(new THREE.Quaternion().fromArray(FORWARD));
      try {
        const place = [state.x, state.y, state.z];
        const response = await answer("depth", [["device", of.name], ["pos", place.join(",")], ["quat", turn.toArray().join(",")]]);
        const bytes = await response.arrayBuffer();
        const n = of.width * of.height;
        const read = new DataView(bytes);
        const state8 = new Uint8Array(bytes, 8 * n);
        const metres = (/** @type {number} */ k) => (state8[k] === 0 ? read.getFloat32(4 * k, true) : NaN);
        images.show({
          width: of.width, height: of.height, far: of.range_m[1], metres, geom: (/** @type {number} */ k) => read.getInt32(4 * (n + k), true),
          missing: (/** @type {number} */ k) => ["", "nothing", "too far", "too near"][state8[k]],
          told: (/** @type {string} */ range) => `Yellow is near, dark blue ${range}, black nothing in range, which is ${of.range_m[0]} to ` +
            `${of.range_m[1]} m. Distances ${of.kind === "range" ? "along the ray" : "along the camera's axis"}, without the device's noise.`,
        });
        told.textContent = "";
      } catch (fault) {
        told.textContent = /** @type {Error} */ (fault).message;
      }
      view.need();
    });

    /** The pyramid that the device sees, up to a metre. */
    function drawPyramid() {
      const of = chosen();
      const half = Math.tan((of.fovy_deg * Math.PI) / 360);
      const wide = (half * of.width) / of.height;
      const corners = [[1, wide, half], [1, -wide, half], [1, -wide, -half], [1, wide, -half]];
      const points = corners.flatMap((c, k) => [0, 0, 0, ...c, ...c, ...corners[(k + 1) % 4]]);
      pyramid.geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(points), 3));
    }

    const fly = P.el("button", { type: "button", "aria-pressed": "false" }, "Fly a depth camera");
    const outside = P.el("button", { type: "button", "aria-pressed": "false" }, "Look from outside");
    const pad = P.el("div", { class: "buttons pad", role: "group", "aria-label": "move the camera" }, ...MOVES.map(([name, , text, move]) =>
      P.el("button", { type: "button", "aria-label": name, title: name, onclick: (/** @type {MouseEvent} */ e) => go(move, e.shiftKey ? FAST : 1) }, text)));
    const camera = P.el("div", { hidden: true },
      P.el("div", { class: "choices" }, P.el("label", { class: "choice" }, P.el("span", {}, "Device"), device), outside),
      pad, P.el("p", { class: "small" }, "Keys, with the picture in focus: W S ahead and back, A D left and right, E Q up and down, arrows turn and look; " +
        "shift goes five times as far."),
      P.el("div", { class: "choices" }, ...fields.map((f) => f.element)), told);

    /** @param {boolean} on */
    function take(on) {
      view.pilot = on ? key : null;
      fly.setAttribute("aria-pressed", String(on));
      camera.hidden = images.element.hidden = !on;
      view.target = on ? rig : null;
      if (!on) rig.visible = false;
      look(on ? "first person" : "orbit");
      if (!on) return;
      drawPyramid();
      set({});
      view.canvas.focus();
    }

    /** @param {string} how */
    function look(how) {
      view.mount = { pos: [0, 0, 0], quat: FORWARD, fov: chosen().fovy_deg };
      view.setView(how);
      rig.visible = flying() && how !== "first person";
      outside.setAttribute("aria-pressed", String(how !== "first person"));
      view.need();
    }

    /** @param {KeyboardEvent} event @returns {boolean} whether the key was for the camera */
    function key(event) {
      const found = MOVES.find((m) => m[1] === event.key.toLowerCase());
      if (!found || event.ctrlKey || event.metaKey || event.altKey) return false;
      event.preventDefault();
      go(found[3], event.shiftKey ? FAST : 1);
      return true;
    }
    fly.addEventListener("click", () => take(!flying()));
    outside.addEventListener("click", () => look(view.view === "first person" ? "orbit" : "first person"));
    device.addEventListener("change", () => {
      drawPyramid();
      look(view.view);
      ask({});
    });

    // ----- a path -------------------------------------------------------------------------------------------------------------

    const shell = P.el("select", {}, ...choices.shells.map((/** @type {string} */ s) => P.el("option", { value: s }, s)));
    const places = P.el("textarea", { rows: 4, spellcheck: "false", placeholder: "0 0 1\n2 0 1" });
    const said = P.el("p", { role: "status", class: "words" });
    /** @type {any[]} */
    let drawn = [];
    const mark = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ size: 9 * Math.min(2, devicePixelRatio), sizeAttenuation: false, depthTest: false }));
    mark.visible = false;
    mark.frustumCulled = false;
    mark.renderOrder = 4;
    view.scene.add(mark);
    P.onTheme(() => mark.material.color.set(P.color("contact")));

    /** Lines of the box as places; what is wrong with them in words. */
    function read() {
      const lines = places.value.split("\n").map((/** @type {string} */ l) => l.trim()).filter(Boolean);
      const out = lines.map((/** @type {string} */ line, /** @type {number} */ k) => {
        const numbers = line.split(/[\s,;]+/).map(Number);
        if (numbers.length !== 3 || !numbers.every(Number.isFinite)) throw new Error(`Line ${k + 1}: expected x y z in m, such as 0 0 1; found "${line}".`);
        return numbers;
      });
      if (out.length < 2 || out.length > choices.most_places) throw new Error(`Expected 2 to ${choices.most_places} places, one in each line; found ${out.length}.`);
      return out;
    }

    function clear() {
      drawn.forEach((p) => p.remove());
      drawn = [];
      mark.visible = false;
      view.highlight(null);
      view.need();
    }

    const place = (/** @type {number[]} */ p) => p.map((v) => P.number(v)).join(", ");

    async function tryIt() {
      clear();
      try {
        const list = read();
        said.textContent = "…";
        const tried = await (await answer("path", [["shell", shell.value], ...list.map((/** @type {number[]} */ p) => /** @type {[string, string]} */ (["at", p.join(",")]))])).json();
        const hit = tried.hit;
        const free = hit ? [...list.slice(0, hit.leg + 1), hit.pos_m] : list;
        drawn.push(view.addPath(new Float32Array(free.flat()), { role: "found" }));
        if (hit) drawn.push(view.addPath(new Float32Array([hit.pos_m, ...list.slice(hit.leg + 1)].flat()), { role: "contact" }));
        if (hit) {
          mark.geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(hit.point_m), 3));
          mark.visible = true;
          view.highlight(data.scene.geoms.findIndex((/** @type {any} */ g) => g.name === hit.name));
        }
        const near = tried.nearest ? ` Nearest before that: ${P.number(tried.nearest.distance_m, "m")} to ${tried.nearest.name}, at ${place(tried.nearest.pos_m)}.` : "";
        if (hit?.at_start) said.textContent = `The drone overlaps ${hit.name} where the path begins.`;
        else if (hit) said.textContent = `${shell.value} touches ${hit.name} after ${P.number(hit.after_m, "m")}, at ${place(hit.point_m)}` + (hit.exact ? "." : " (or a little later).") + near;
        else said.textContent = `${shell.value} touches nothing on ${P.number(tried.length_m, "m")}.` +
          (tried.nearest ? ` Nearest: ${P.number(tried.nearest.distance_m, "m")} to ${tried.nearest.name}, at ${place(tried.nearest.pos_m)}.` : " Nothing is nearer than 2 m.");
      } catch (fault) {
        said.textContent = /** @type {Error} */ (fault).message;
      }
      view.need();
    }

    const add = P.el("button", { type: "button", onclick: () => {
      const line = [state.x, state.y, state.z].map(rounded).join(" ");
      places.value = places.value.trimEnd() + (places.value.trim() ? "\n" : "") + line;
    } }, "Add the camera's place");
    const way = P.el("details", { class: "list" }, P.el("summary", {}, "Try a path"),
      P.el("p", { class: "small" }, "Straight lines between places, the drone level with its nose along x: what it touches first."),
      P.el("div", { class: "choices" }, P.el("label", { class: "choice" }, P.el("span", {}, "Drone"), shell)),
      P.el("label", { class: "choice" }, P.el("span", {}, "Places x y z, m, one in each line"), places),
      P.el("div", { class: "buttons" }, P.el("button", { type: "button", onclick: tryIt }, "Try it"), add,
        P.el("button", { type: "button", onclick: () => { places.value = said.textContent = ""; clear(); } }, "Clear")),
      said);

    side.prepend(P.el("div", { class: "probe" }, P.el("div", { class: "choices" }, fly), camera, images.element), way);
    S.probe = { state, set, go, images, places, tryIt, said, take };
  }

  // The scene may be there before this script.
  if (P.shown) start(P.shown);
  else document.addEventListener("propwash-shown", () => start(P.shown));
})();

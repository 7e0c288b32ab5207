// @ts-check
"use strict";
// The page of `propwash view`: a scene, the worlds of a data set, a flight log, or a simulation as it is now.
(() => {
  const P = globalThis.Propwash;
  const D = P.json("flight");
  const LAYERS = { cut: "Cut away what is before it", path: "Path", contacts: "Contacts", frustum: "Camera", nearest: "Clearance line", unseen: "What depth does not see" };
  /** Most drones whose lines stand in one plot. */
  const MOST_LINES = 6;

  const main = /** @type {HTMLElement} */ (document.getElementById("view"));
  const title = D.title;
  const view = new P.Scene3D({ label: `${D.kind} ${title} in three dimensions` });
  const words = P.el("p", { role: "status", class: "words" });
  const tip = P.el("div", { class: "tip", hidden: true });
  const picture = P.el("div", { class: "picture" }, view.canvas, tip);
  const layers = P.el("div", { class: "layers", role: "group", "aria-label": "what is drawn" });
  const legend = P.el("div", { class: "scale" });
  const side = P.el("aside", { class: "side", "aria-label": "camera and lists" });
  const choices = P.el("div", { class: "choices" });
  const dock = P.el("div", { class: "dock" });
  const graphs = P.el("section", { class: "graphs", "aria-label": "over time" });

  const first = D.worlds[0];
  const player = new P.Player(first?.from ?? 0, first?.to ?? 0);
  const flies = D.worlds.some((/** @type {any} */ w) => w.to > w.from);
  const hidden = new Set();

  /** @type {any} the world that is shown, decoded */
  let world = null;
  /** @type {any[]} */
  let drones = [];
  let drone = 0;
  /** @type {any[]} groups that carry the geoms of obstacles */
  let carried = [];
  /** @type {any[]} */
  let paths = [];
  /** @type {any} */
  let marks = null;
  let limit = 1;

  // ----- data ---------------------------------------------------------------------------------------------------------------

  const { rows } = P;

  /** @param {any} spec */
  async function track(spec) {
    const [t, pos, quat, speed] = await Promise.all([P.unpack(spec.t), rows(spec.pos), rows(spec.quat), P.unpack(spec.speed)]);
    return { t, pos, quat, speed };
  }

  /** @param {any} spec */
  async function decoded(spec) {
    const list = (/** @type {any[]} */ of, /** @type {(v: any) => Promise<any>} */ how) => Promise.all(of.map(how));
    const near = async (/** @type {any} */ c) => ({
      t: await P.unpack(c.t), distance: await P.unpack(c.distance), from: await rows(c.from), to: await rows(c.to), geom: await P.unpack(c.geom),
    });
    const c = spec.contacts;
    const contacts = c && {
      count: c.count, t: await P.unpack(c.t), drone: await P.unpack(c.drone), pos: await list(c.pos, P.unpack),
      normal: await list(c.normal, P.unpack), geoms: await list(c.geoms, P.unpack),
    };
    const f = spec.frames;
    const frames = f && {
      t: P.array(f.t), pos: await list(f.pos, rows), quat: await list(f.quat, rows), depth: f.depth, geom: f.geom,
      with: f.depth.map((/** @type {any[]} */ d, /** @type {number} */ k) => (d.length ? k : -1)).filter((/** @type {number} */ k) => k >= 0),
    };
    const ghosts = await list(spec.ghosts, async (g) => ({ every: g.every, track: await track(g.track), starts: P.array(g.starts) }));
    return {
      spec, contacts, frames, ghosts, drones: await list(spec.drones, track), obstacles: await list(spec.obstacles, track),
      clearance: await list(spec.clearance, near),
    };
  }

  const label = (/** @type {number} */ id) => (id < 0 ? "nothing" : (D.scene?.geoms[id]?.name ?? `geom #${id}`));
  const nameOf = (/** @type {number} */ d) => (D.drones.length > 1 ? `drone ${d} (${D.drones[d].name})` : D.drones[d].name);

  /** Clearance of a drone at a moment; NaN where it is not known. @param {number} d @param {number} time */
  function clearance(d, time) {
    const c = world?.clearance[d];
    return c?.t.length ? c.distance[P.before(c.t, time)] : NaN;
  }

  /** What colours the path, from 0 to 1. @param {number} d @param {number} time */
  function share(d, time) {
    if (D.colour === "clearance") {
      const distance = clearance(d, time);
      return Number.isFinite(distance) ? 1 - distance / limit : 0;
    }
    const of = world.drones[d];
    return of.speed[P.before(of.t, time)] / limit;
  }

  // ----- the scene ----------------------------------------------------------------------------------------------------------

  async function addScene() {
    if (!D.scene) return;
    carried = await view.addScene(D.scene, (/** @type {any} */ geom) => drones[geom.drone]);
  }

  /** Puts obstacles where they are at a moment, or where the scene has them. @param {number} time */
  function placeObstacles(time) {
    carried.forEach((group, k) => {
      const of = world?.obstacles[k];
      const { pos, quat } = of ? P.poseAt(of, time) : { pos: D.scene.rest[k][0], quat: D.scene.rest[k][1] };
      group.position.fromArray(pos);
      group.quaternion.fromArray(quat);
    });
  }

  /** Corners of a box around what matters: paths, else the geoms that are not huge. */
  function bounds() {
    const box = new THREE.Box3();
    const huge = 30;
    for (const mesh of view.geoms) {
      const geom = mesh.userData.geom;
      const one = geom.kind === "plane" || geom.drone !== undefined ? null : new THREE.Box3().setFromObject(mesh);
      if (one && one.getSize(new THREE.Vector3()).length() < huge) box.union(one);
    }
    const flown = new THREE.Box3();
    for (const of of world?.drones ?? []) {
      for (let k = 0; k < of.t.length; k++) {
        const at = new THREE.Vector3(of.pos[3 * k], of.pos[3 * k + 1], of.pos[3 * k + 2]);
        if (Number.isFinite(at.x + at.y + at.z)) flown.expandByPoint(at);
      }
    }
    if (!flown.isEmpty()) {
      const size = Math.max(0.3, flown.getSize(new THREE.Vector3()).length());
      flown.expandByScalar(0.1 * size);
      return flown;
    }
    return box.isEmpty() ? new THREE.Box3(new THREE.Vector3(-2, -2, 0), new THREE.Vector3(2, 2, 2)) : box;
  }

  /** Opens the picture towards the flight, so that a ceiling or a tree does not hide it. */
  function cut() {
    view.cut = flies && D.scene && !hidden.has("cut") ? bounds() : null;
  }

  function ground() {
    if (D.scene || !world) return;
    const box = bounds();
    const size = Math.ceil(2 * Math.max(box.max.x - box.min.x, box.max.y - box.min.y, 2));
    const middle = box.getCenter(new THREE.Vector3());
    view.addGrid(size, [Math.round(middle.x), Math.round(middle.y), Math.min(0, box.min.z)]);
  }

  // ----- one world ----------------------------------------------------------------------------------------------------------

  function addContacts() {
    if (marks) view.scene.remove(marks);
    marks = null;
    const c = world.contacts;
    if (!c) return;
    marks = new THREE.Group();
    const size = 0.02 + 0.15 * (drones[0]?.userData.reach ?? 0.1);
    const places = new Float32Array(3 * c.count);
    const lines = new Float32Array(6 * c.count);
    for (let k = 0; k < c.count; k++) {
      for (let n = 0; n < 3; n++) places[3 * k + n] = c.pos[n][k];
      for (let n = 0; n < 3; n++) {
        lines[6 * k + n] = c.pos[n][k];
        lines[6 * k + 3 + n] = c.pos[n][k] + 4 * size * c.normal[n][k];
      }
    }
    const shape = (/** @type {Float32Array} */ of) => new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(of, 3));
    const color = P.color("contact");
    const dots = new THREE.PointsMaterial({ color, size: 6 * Math.min(2, devicePixelRatio), sizeAttenuation: false });
    const points = new THREE.Points(shape(places), dots);
    const normals = new THREE.LineSegments(shape(lines), new THREE.LineBasicMaterial({ color }));
    marks.add(points, normals);
    marks.userData = { points, normals };
    marks.visible = !hidden.has("contacts");
    view.scene.add(marks);
  }

  const frustum = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial());
  const nearest = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial());
  const ghost = D.worlds.some((/** @type {any} */ w) => w.ghosts.length) ? view.addDrone(D.drones[0], { role: "filed", opacity: 0.55 }) : null;
  let every = NaN;
  for (const line of [frustum, nearest]) {
    line.frustumCulled = false;
    view.scene.add(line);
  }
  P.onTheme(() => {
    frustum.material.color.set(P.color("found"));
    nearest.material.color.set(P.color("contact"));
    marks?.userData.points.material.color.set(P.color("contact"));
    marks?.userData.normals.material.color.set(P.color("contact"));
  });

  /** @param {any} line @param {number[]} points */
  function setLine(line, points) {
    line.geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(points), 3));
  }

  /** The pyramid that the camera sees, up to a metre. @param {number} f number of the frame */
  function drawFrustum(f) {
    const camera = D.camera;
    const { pos, quat } = world.frames;
    const [[fx, , cx], [, fy, cy]] = camera.k;
    const turn = new THREE.Quaternion().fromArray(quat[drone], 4 * f);
    const from = new THREE.Vector3().fromArray(pos[drone], 3 * f);
    const reach = Math.min(1, camera.far);
    const corner = (/** @type {number} */ u, /** @type {number} */ v) =>
      new THREE.Vector3((u - cx) / fx, -(v - cy) / fy, -1).multiplyScalar(reach).applyQuaternion(turn).add(from);
    const corners = [corner(0, 0), corner(camera.width, 0), corner(camera.width, camera.height), corner(0, camera.height)];
    const pairs = corners.flatMap((c, k) => [from, c, c, corners[(k + 1) % 4]]);
    setLine(frustum, pairs.flatMap((p) => p.toArray()));
  }

  /** @param {number} k number in the list of worlds */
  async function show(k) {
    const asked = D.worlds[k];
    const next = await decoded(asked);
    world = next;
    paths.forEach((p) => p.remove());
    const all = D.colour === "clearance"
      ? world.clearance.flatMap((/** @type {any} */ c) => Array.from(c.distance).filter(Number.isFinite))
      : world.drones.flatMap((/** @type {any} */ d) => Array.from(d.speed).filter(Number.isFinite));
    const sorted = all.sort((/** @type {number} */ a, /** @type {number} */ b) => a - b);
    limit = Math.max(D.colour === "clearance" ? (sorted[Math.floor(0.8 * sorted.length)] ?? 1) : (sorted[sorted.length - 1] ?? 1), 0.05);
    paths = world.drones.map((/** @type {any} */ of, /** @type {number} */ d) => {
      const path = view.addPath(of.pos);
      path.colour((/** @type {number} */ n) => share(d, of.t[n]));
      path.show(!hidden.has("path"));
      return path;
    });
    addContacts();
    cut();
    mount();
    player.limits(asked.from, asked.to);
    drawScale();
    strip?.draw();
    plots?.set(lines());
    contactList();
    step(player.time);
  }

  /** Where the camera sits on the drone, from the first frame. */
  function mount() {
    view.mount = null;
    if (!world.frames?.t.length) return;
    const pose = P.poseAt(world.drones[drone], world.frames.t[0]);
    const back = new THREE.Quaternion().fromArray(pose.quat).invert();
    const at = new THREE.Vector3().fromArray(world.frames.pos[drone]).sub(new THREE.Vector3().fromArray(pose.pos)).applyQuaternion(back);
    const turn = back.multiply(new THREE.Quaternion().fromArray(world.frames.quat[drone]));
    view.mount = { pos: at.toArray(), quat: turn.toArray(), fov: (360 / Math.PI) * Math.atan((0.5 * D.camera.height) / D.camera.k[1][1]) };
  }

  // ----- a moment -----------------------------------------------------------------------------------------------------------

  /** @param {number} time */
  function step(time) {
    if (!world) return;
    world.drones.forEach((/** @type {any} */ of, /** @type {number} */ d) => {
      const { pos, quat } = P.poseAt(of, time);
      drones[d].place(pos, quat);
    });
    placeObstacles(time);
    const flown = world.ghosts.find((/** @type {any} */ g) => g.every === every);
    if (ghost) {
      const pose = flown ? P.poseAt(flown.track, time) : { pos: [NaN], quat: [] };
      ghost.place(pose.pos, pose.quat);
    }
    const c = world.clearance[drone];
    nearest.visible = false;
    if (c?.t.length && !hidden.has("nearest")) {
      const k = P.before(c.t, time);
      nearest.visible = Number.isFinite(c.distance[k]);
      setLine(nearest, [...c.from.slice(3 * k, 3 * k + 3), ...c.to.slice(3 * k, 3 * k + 3)]);
    }
    frustum.visible = Boolean(world.frames?.t.length) && !hidden.has("frustum") && view.view !== "first person";
    if (world.frames?.t.length) {
      drawFrustum(P.before(world.frames.t, time + 1e-6));
      drawImages(time);
    }
    view.moved();
    say();
  }

  let last = "";
  let said = 0;
  let later = 0;
  /** The picture in words, at most every second while it plays. */
  function say() {
    const now = performance.now();
    clearTimeout(later);
    if (player.playing && now - said < 1000) {
      later = setTimeout(say, 1000);
      return;
    }
    said = now;
    const text = sentence();
    if (text !== last) words.textContent = text;
    last = text;
  }

  function sentence() {
    if (!world) return D.scene ? `${D.scene.geoms.length} geoms, ${unseen().length} of them not seen by depth images.` : "";
    const of = world.drones[drone];
    const pose = P.poseAt(of, player.time);
    if (!Number.isFinite(pose.pos[0])) return `${player.time.toFixed(2)} s: ${nameOf(drone)} was not measured here.`;
    const speed = of.speed[pose.k];
    const parts = [`${player.time.toFixed(2)} s: ${nameOf(drone)} at x ${P.number(pose.pos[0])}, y ${P.number(pose.pos[1])}, height ${P.number(pose.pos[2], "m")}`];
    if (Number.isFinite(speed)) parts.push(P.number(speed, "m/s"));
    const c = world.clearance[drone];
    if (c?.t.length) {
      const k = P.before(c.t, player.time);
      if (Number.isFinite(c.distance[k])) parts.push(`clearance ${P.number(c.distance[k], "m")} to ${label(Math.round(c.geom[k]))}`);
      else parts.push("nothing near");
    }
    const touching = touched();
    if (touching) parts.push(`contacts so far: ${touching}`);
    return parts.join(", ") + (world.spec.note ? `. This world ${world.spec.note}` : "") + ".";
  }

  function touched() {
    const c = world.contacts;
    return c ? Array.from(c.t).filter((t, k) => t <= player.time + 1e-9 && c.drone[k] === drone).length : 0;
  }

  // ----- camera images ------------------------------------------------------------------------------------------------------

  const images = new P.DepthImages({ label, light: (/** @type {number | null} */ geom) => view.highlight(geom) });
  /** @type {any} */
  let image = null;
  let asked = -1;

  /** The image of a drone in a frame: values of the 16-bit image and numbers of geoms (0 none), row by row.
   * @param {number} f @param {number} d */
  async function read(f, d) {
    const { width } = D.camera;
    const [halves, geoms] = await Promise.all([P.unpack(world.frames.depth[f][d]), P.unpack(world.frames.geom[f][d])]);
    const n = halves.length / 2;
    const values = new Uint16Array(n);
    // The other way round of what `worlds.rs` does: each value is that of its neighbours and a difference.
    for (let k = 0; k < n; k++) {
      const folded = halves[k] | (halves[n + k] << 8);
      const left = k % width ? values[k - 1] : 0;
      const up = k >= width ? values[k - width] : 0;
      const corner = k % width && k >= width ? values[k - width - 1] : 0;
      const guess = corner >= Math.max(left, up) ? Math.min(left, up) : corner <= Math.min(left, up) ? Math.max(left, up) : left + up - corner;
      values[k] = guess + (folded & 1 ? -((folded + 1) >> 1) : folded >> 1);
    }
    return { f, d, values, geoms };
  }

  /** Metres of a value of an image; NaN for a miss and for what is out of range. @param {number} value */
  const metres = (value) => (D.camera.codes.includes(value) ? NaN : value * D.camera.unit);

  /** @param {number} time */
  async function drawImages(time) {
    const there = world.frames.with;
    if (!there.length) return;
    const times = there.map((/** @type {number} */ f) => world.frames.t[f]);
    let n = P.before(times, time);
    if (n + 1 < times.length && times[n + 1] - time < time - times[n]) n++;
    const key = there[n] * 1000 + drone;
    if (key === asked) return;
    asked = key;
    const next = await read(there[n], drone);
    if (asked !== key) return;
    image = next;
    paint();
  }

  function paint() {
    const [miss, near] = D.camera.codes;
    const value = (/** @type {number} */ k) => image.values[k];
    images.show({
      width: D.camera.width, height: D.camera.height, far: D.camera.far,
      metres: (/** @type {number} */ k) => metres(value(k)), geom: (/** @type {number} */ k) => image.geoms[k] - 1,
      missing: (/** @type {number} */ k) => (value(k) === miss ? "nothing" : value(k) === near ? "too near" : "too far"),
      told: (/** @type {string} */ range) => `Image of ${world.frames.t[image.f].toFixed(2)} s: yellow is near, dark blue ${range}, black nothing in range. ` +
        `Distances ${D.camera.kind === "range" ? "along the ray" : "along the camera's axis"}.`,
    });
  }

  // ----- pointing at geoms --------------------------------------------------------------------------------------------------

  const unseen = () => (D.scene?.geoms ?? []).filter((/** @type {any} */ g) => !g.seen && g.drone === undefined);

  /** A geom in words. @param {any} g */
  const told3d = (g) => `${g.name}: ${g.kind}, group ${g.group}` + (g.why ? `. ${g.seen ? "" : "Depth does not see it. "}${g.why}` : "");

  let waiting = false;
  view.canvas.addEventListener("pointermove", (/** @type {PointerEvent} */ event) => {
    if (waiting || event.buttons) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      point(event.offsetX, event.offsetY);
    });
  });
  view.canvas.addEventListener("click", (/** @type {MouseEvent} */ event) => point(event.offsetX, event.offsetY));
  view.canvas.addEventListener("pointerleave", () => {
    tip.hidden = true;
    view.highlight(null);
  });

  /** @param {number} x @param {number} y */
  function point(x, y) {
    const hit = view.pick(x, y);
    view.highlight(hit ? hit.index : null);
    tip.hidden = !hit;
    if (!hit) return;
    tip.textContent = told3d(D.scene.geoms[hit.index]);
    tip.style.left = Math.max(4, Math.min(x + 14, picture.clientWidth - tip.offsetWidth - 6)) + "px";
    tip.style.top = Math.max(4, Math.min(y + 14, picture.clientHeight - tip.offsetHeight - 6)) + "px";
  }

  // ----- around the picture -------------------------------------------------------------------------------------------------

  function drawScale() {
    const stops = Array.from({ length: 10 }, (_, k) => P.css(P.cividis(k / 9)));
    const bar = P.el("i");
    bar.style.background = `linear-gradient(to right, ${stops.join(", ")})`;
    const near = D.colour === "clearance";
    legend.replaceChildren(near ? `clearance ≥ ${P.number(limit, "m")}` : "speed 0", bar, near ? "0 m" : P.number(limit, "m/s"));
  }

  /** Plots of the world that is shown. */
  function lines() {
    const shown = world.drones.slice(0, MOST_LINES);
    const t = shown[0]?.t ?? [];
    const at = (/** @type {any} */ of, /** @type {ArrayLike<number>} */ times, /** @type {(k: number) => number} */ value) =>
      Array.from(times, (time) => value(P.before(of.t, time)));
    const series = (/** @type {(of: any, k: number) => number} */ value) => shown.map((/** @type {any} */ of, /** @type {number} */ d) => ({
      name: nameOf(d), role: "c" + (d % 6), y: at(of, t, (k) => value(of, k)),
    }));
    const list = [
      { title: "Speed", unit: "m/s", t, series: series((of, k) => of.speed[k]) },
      { title: "Height", unit: "m", t, series: series((of, k) => of.pos[3 * k + 2]) },
    ];
    const c = world.clearance[0];
    if (c) {
      const near = world.clearance.slice(0, MOST_LINES);
      list.push({ title: "Clearance", unit: "m", t: c.t, series: near.map((/** @type {any} */ of, /** @type {number} */ d) => ({
        name: nameOf(d), role: "c" + (d % 6), y: at(of, c.t, (k) => of.distance[k]),
      })) });
    }
    return list;
  }

  const contactBox = P.el("details", { class: "list", hidden: true });
  function contactList() {
    const c = world.contacts;
    contactBox.hidden = !c;
    if (!c) return;
    const rows = Array.from({ length: Math.min(c.count, 200) }, (_, k) => P.el("li", {},
      P.el("button", { type: "button", onclick: () => player.set(c.t[k]) }, c.t[k].toFixed(3) + " s"),
      ` ${nameOf(c.drone[k])}: ${label(c.geoms[0][k])} on ${label(c.geoms[1][k])}`));
    const more = c.count > rows.length ? [P.el("li", {}, `and ${c.count - rows.length} more`)] : [];
    contactBox.replaceChildren(P.el("summary", {}, `Contacts: ${c.count}`), P.el("ul", {}, ...rows, ...more));
  }

  /** @param {string} name @param {(string | Node)[]} items */
  const list = (name, items) => P.el("details", { class: "list" }, P.el("summary", {}, name), P.el("ul", {}, ...items.map((i) => P.el("li", {}, i))));

  function addLayers() {
    const has = {
      cut: flies && D.scene, path: flies, contacts: D.worlds.some((/** @type {any} */ w) => w.contacts), frustum: D.worlds.some((/** @type {any} */ w) => w.frames),
      nearest: D.worlds.some((/** @type {any} */ w) => w.clearance.length), unseen: (D.scene?.geoms ?? []).some((/** @type {any} */ g) => !g.seen),
    };
    for (const [key, name] of Object.entries(LAYERS)) {
      if (!has[/** @type {keyof typeof has} */ (key)]) continue;
      const box = P.el("input", { type: "checkbox", checked: true });
      box.addEventListener("change", () => {
        if (box.checked) hidden.delete(key);
        else hidden.add(key);
        paths.forEach((p) => p.show(!hidden.has("path")));
        if (marks) marks.visible = !hidden.has("contacts");
        if (key === "unseen") view.showUnseen(box.checked);
        if (key === "cut") cut();
        step(player.time);
        view.need();
      });
      layers.append(P.el("label", {}, box, " " + name));
    }
  }

  /** @param {string} name @param {[string, string][]} options @param {(value: string) => void} then */
  function choice(name, options, then) {
    const select = P.el("select", {}, ...options.map(([value, text]) => P.el("option", { value }, text)));
    select.addEventListener("change", () => then(select.value));
    choices.append(P.el("label", { class: "choice" }, P.el("span", {}, name), select));
    return select;
  }

  /** @type {any} */
  let strip = null;
  /** @type {any} */
  let plots = null;

  /** Which of the drones is followed. @param {number} d */
  function choose(d) {
    drone = d;
    view.target = drones[d];
    mount();
    strip?.draw();
    asked = -1;
    step(player.time);
  }

  function build() {
    const pieces = [P.el("div", { class: "stage" }, picture, P.el("div", { class: "bar" }, view.viewButtons(D.worlds.length > 0), layers), legend, words)];
    if (D.worlds.some((/** @type {any} */ w) => w.frames)) side.append(images.element);
    side.prepend(choices);
    side.append(contactBox);
    const blind = (D.scene?.geoms ?? []).filter((/** @type {any} */ g) => g.why && g.drone === undefined);
    if (blind.length) side.append(list(`What sensors miss: ${blind.length}`, blind.map((/** @type {any} */ g) => `${g.name}: ${g.why}`)));
    if (D.notes.length) {
      const notes = list(`Notes: ${D.notes.length}`, D.notes);
      notes.setAttribute("open", "");
      side.append(notes);
    }
    side.append(list("Keys", ["Space: play, pause", "← →: 0.1 s, with shift 1 s", "with the picture in focus: A D round, W S over, + − nearer and farther"]));
    if (flies) {
      strip = P.strip(player, { label: `${D.colour} over time`, share: (/** @type {number} */ t) => (world ? share(drone, t) : NaN),
        ticks: () => (world?.ghosts.find((/** @type {any} */ g) => g.every === every)?.starts ?? []) });
      dock.append(player.controls(), strip.element);
      player.keys();
      plots = P.timePlots(player, []);
      graphs.append(P.el("h2", {}, "Over time, s"), plots.element);
      pieces.push(side, dock, graphs);
    } else {
      legend.hidden = true;
      pieces.push(side);
    }
    main.append(...pieces);
    const actions = document.getElementById("actions");
    actions?.append(P.linkButton(() => ({
      ...(flies ? { t: player.time.toFixed(3) } : {}), ...(D.worlds.length > 1 ? { world: String(world.spec.number) } : {}),
      ...(drones.length > 1 ? { drone: String(drone) } : {}), cam: view.cameraText(),
    })), P.themeButton());
  }

  async function start() {
    const count = (/** @type {number} */ n, /** @type {string} */ of) => `${n} ${of}${n === 1 ? "" : "s"}`;
    const facts = [D.kind];
    if (D.worlds.length && D.kind !== "flight log") facts.push(count(D.worlds.length, "world"));
    if (D.drones.length) facts.push(D.drones.length === 1 ? D.drones[0].name : count(D.drones.length, "drone"));
    if (D.scene) facts.push(`${D.scene.name}, ${count(D.scene.geoms.length, "geom")}`);
    const about = document.getElementById("about");
    if (about) about.textContent = facts.join(" · ");
    const model = (/** @type {any} */ d) => ({ rotors: d.rotors, radius: d.radius ?? undefined, bare: d.shell });
    drones = D.worlds.length ? D.drones.map((/** @type {any} */ d) => view.addDrone(model(d), { role: "drone", halo: true })) : [];
    build();
    addLayers();
    await addScene();
    view.target = drones[0] ?? null;
    const wanted = P.fragment();
    if (D.worlds.length > 1) {
      const worlds = D.worlds.map((/** @type {any} */ w, /** @type {number} */ k) => [String(k), `world ${w.number}`]);
      const select = choice("World", worlds, (k) => show(Number(k)));
      const k = D.worlds.findIndex((/** @type {any} */ w) => String(w.number) === wanted.get("world"));
      if (k > 0) select.value = String(k);
      await show(Math.max(k, 0));
    } else if (D.worlds.length) await show(0);
    if (drones.length > 1) {
      const select = choice("Drone", drones.map((_, d) => [String(d), nameOf(d)]), (d) => choose(Number(d)));
      const d = Number(wanted.get("drone") ?? 0);
      if (drones[d] && d > 0) {
        select.value = String(d);
        choose(d);
      }
    }
    const ghosts = world?.ghosts ?? [];
    if (ghosts.length) {
      const select = choice("Model starts again every", [["", "(not drawn)"], ...ghosts.map((/** @type {any} */ g) => [String(g.every), `${g.every} s`])], (v) => {
        every = v === "" ? NaN : Number(v);
        strip?.draw();
        step(player.time);
      });
      every = ghosts[Math.min(2, ghosts.length - 1)].every;
      select.value = String(every);
      strip?.draw();
    }
    ground();
    const box = bounds();
    view.frame(box.min.toArray(), box.max.toArray());
    placeObstacles(player.time);
    view.cameraFrom(wanted.get("cam"));
    view.changed = () => step(player.time);
    player.on(step);
    const t = Number(wanted.get("t") ?? NaN);
    if (Number.isFinite(t)) player.set(t);
    say();
    // For programs that look at this page, such as its tests.
    P.shown = { view, player, drones, world: () => world, marks: () => marks, show, choose, read, metres, pixel: images.pixel.bind(images), image: () => image, data: D, side, label };
    document.dispatchEvent(new Event("propwash-shown"));
  }
  start();
})();

// @ts-check
"use strict";
// The flight in three dimensions, by three.js: geoms of a scene, quadrotors, paths, arrows, and the cameras that look at them.
// World z points up; quaternions are x y z w; lengths are metres.
(() => {
  const P = (globalThis.Propwash ??= {});

  /** Half edge of the rectangle that stands for an infinite plane, m. */
  const FAR_PLANE = 60;
  /** Whether the line from the camera to a point of a surface goes on into the box: then the point stands before it. */
  const CUT = `
varying vec3 vPlace;
uniform float cutOn;
uniform vec3 cutLow;
uniform vec3 cutHigh;
bool isCut() {
  vec3 way = vPlace - cameraPosition + vec3(1e-7);
  vec3 a = (cutLow - cameraPosition) / way;
  vec3 b = (cutHigh - cameraPosition) / way;
  vec3 low = min(a, b);
  vec3 high = max(a, b);
  float enters = max(max(low.x, low.y), low.z);
  return cutOn > 0.5 && enters > 1.0 && enters < min(min(high.x, high.y), high.z);
}
`;
  /** Vertical field of view, degrees. */
  const FOV = 50;
  const VIEWS = ["orbit", "follow", "first person", "top"];

  class Scene3D {
    /** @param {{label: string}} spec what the picture is called for those who do not see it */
    constructor(spec) {
      this.canvas = P.el("canvas", { class: "scene", tabindex: 0, role: "img", "aria-label": spec.label });
      this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: true, preserveDrawingBuffer: false });
      this.renderer.setPixelRatio(Math.min(2, devicePixelRatio));
      this.scene = new THREE.Scene();
      this.camera = new THREE.PerspectiveCamera(FOV, 1, 0.02, 500);
      this.camera.up.set(0, 0, 1);
      this.controls = new THREE.OrbitControls(this.camera, this.canvas);
      this.controls.addEventListener("change", () => this.need());
      this.light();
      /** @type {any[]} */
      this.geoms = [];
      /** @type {any[]} materials of lines, which must know the size of the picture */
      this.lines = [];
      this.view = "orbit";
      /** @type {any} what is followed: an object with `position` and `quaternion` */
      this.target = null;
      /** @type {{pos: any, quat: any, fov?: number} | null} camera in the frame of what is followed; forward along x without */
      this.mount = null;
      /** @type {{at: any, to: any} | null} where the camera was in orbit */
      this.kept = null;
      /** @type {(() => void) | null} called when the way in which the camera moves was changed */
      this.changed = null;
      /** @type {any} a box, such as that of the flight; seen from outside, what stands before it is cut away, such as a ceiling */
      this.cut = null;
      this.cutting = { cutOn: { value: 0 }, cutLow: { value: new THREE.Vector3() }, cutHigh: { value: new THREE.Vector3() } };
      this.lastTarget = new THREE.Vector3();
      /** @type {((event: KeyboardEvent) => boolean) | null} takes keys before they turn the camera; says whether it took one */
      this.pilot = null;
      this.waiting = false;
      new ResizeObserver(() => this.resize()).observe(this.canvas);
      this.canvas.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => this.turn(event));
      P.onTheme(() => {
        this.scene.background = new THREE.Color(P.color("space") || "#232a33");
        this.need();
      });
    }

    light() {
      this.scene.add(new THREE.HemisphereLight(0xffffff, 0x707880, 2.2));
      const sun = new THREE.DirectionalLight(0xffffff, 1.3);
      sun.position.set(3, -4, 8);
      this.scene.add(sun);
    }

    /** A grid on the ground, for flights without a scene. @param {number} size edge, m @param {[number, number, number]} at */
    addGrid(size, at) {
      const grid = new THREE.GridHelper(size, Math.min(100, Math.max(4, Math.round(size))), 0x7d8794, 0x59626e);
      grid.rotation.x = Math.PI / 2;
      grid.position.set(...at);
      this.scene.add(grid);
      return grid;
    }

    resize() {
      const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
      if (!width || !height) return;
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      this.lines.forEach((material) => material.resolution.set(width, height));
      this.draw();
    }

    /** Lets go of the graphics card's memory: a page may have only so many pictures in 3-D. */
    end() {
      this.controls.dispose();
      this.renderer.dispose();
      this.renderer.forceContextLoss();
    }

    /** Draws with the next frame. */
    need() {
      if (this.waiting) return;
      this.waiting = true;
      requestAnimationFrame(() => {
        this.waiting = false;
        this.draw();
      });
    }

    draw() {
      this.cutting.cutOn.value = this.cut && (this.view === "orbit" || this.view === "top") ? 1 : 0;
      if (this.cut) {
        this.cutting.cutLow.value.copy(this.cut.min);
        this.cutting.cutHigh.value.copy(this.cut.max);
      }
      this.renderer.render(this.scene, this.camera);
    }

    // ----- geoms ------------------------------------------------------------------------------------------------------------

    /** A scene of the page's data: its geoms, with obstacles where the scene has them.
     * @param {any} scene @param {(geom: any) => any} [carrier] the object in whose frame a geom stands, if it is neither the world's nor an obstacle's
     * @returns {Promise<any[]>} the obstacles */
    async addScene(scene, carrier) {
      const meshes = await Promise.all(scene.meshes.map(async (/** @type {any} */ m) => {
        const faces = await P.unpack(m.faces);
        for (let k = 1; k < faces.length; k++) faces[k] = (faces[k] + faces[k - 1]) >>> 0;
        return { vertices: await P.rows(m.vertices), faces };
      }));
      const carried = scene.rest.map((/** @type {any} */ [pos, quat]) => {
        const group = new THREE.Group();
        group.position.set(pos[0], pos[1], pos[2]);
        group.quaternion.set(quat[0], quat[1], quat[2], quat[3]);
        this.scene.add(group);
        return group;
      });
      this.addGeoms(scene.geoms, meshes, (geom) => carrier?.(geom) ?? carried[geom.obstacle]);
      return carried;
    }

    /** All geoms of a scene; `seen: false` draws a geom hatched, with its outline.
     * @param {{kind: string, size: number[], pos: number[], quat: number[], rgba: number[], name: string, seen: boolean, mesh?: number}[]} list
     * @param {{vertices: Float32Array, faces: Uint32Array}[]} meshes
     * @param {(geom: any) => any} [carrier] the object in whose frame a geom stands, if it is not the world's */
    addGeoms(list, meshes, carrier) {
      const shapes = meshes.map((m) => {
        const shape = new THREE.BufferGeometry();
        shape.setAttribute("position", new THREE.BufferAttribute(m.vertices, 3));
        shape.setIndex(new THREE.BufferAttribute(m.faces, 1));
        const flat = shape.toNonIndexed();
        flat.computeVertexNormals();
        return flat;
      });
      list.forEach((geom, k) => {
        const shape = geom.mesh === undefined ? primitive(geom.kind, geom.size) : shapes[geom.mesh];
        const mesh = new THREE.Mesh(shape, this.surface(geom));
        if (geom.kind === "ellipsoid") mesh.scale.set(geom.size[0], geom.size[1], geom.size[2]);
        mesh.position.set(geom.pos[0], geom.pos[1], geom.pos[2]);
        mesh.quaternion.set(geom.quat[0], geom.quat[1], geom.quat[2], geom.quat[3]);
        mesh.userData = { geom, index: k };
        if (!geom.seen) mesh.add(outline(shape));
        else if (geom.kind === "plane") mesh.add(metres(geom.size));
        (carrier?.(geom) ?? this.scene).add(mesh);
        this.geoms.push(mesh);
      });
      this.need();
      return this.geoms;
    }

    /** @param {any} geom */
    surface(geom) {
      const [r, g, b, alpha] = geom.rgba;
      const material = new THREE.MeshLambertMaterial({
        color: new THREE.Color().setRGB(r, g, b, THREE.SRGBColorSpace), side: geom.kind === "sphere" ? THREE.FrontSide : THREE.DoubleSide,
        transparent: geom.seen && alpha < 1, opacity: geom.seen ? Math.max(alpha, 0.05) : 1,
      });
      const hatch = geom.seen ? "" : "  if (mod(gl_FragCoord.x + gl_FragCoord.y, 12.0) > 3.0) discard;\n";
      material.onBeforeCompile = (/** @type {any} */ shader) => {
        Object.assign(shader.uniforms, this.cutting);
        shader.vertexShader = "varying vec3 vPlace;\n" + shader.vertexShader.replace("#include <project_vertex>",
          "#include <project_vertex>\n  vPlace = (modelMatrix * vec4(transformed, 1.0)).xyz;");
        shader.fragmentShader = CUT + shader.fragmentShader.replace("void main() {", `void main() {\n  if (isCut()) discard;\n${hatch}`);
      };
      material.customProgramCacheKey = () => (geom.seen ? "solid" : "hatched");
      return material;
    }

    /** Shows or hides what the sensors do not see. @param {boolean} on */
    showUnseen(on) {
      this.geoms.filter((m) => !m.userData.geom.seen).forEach((m) => (m.visible = on));
      this.need();
    }

    /** Lights up one geom, or none. @param {number | null} index */
    highlight(index) {
      for (const mesh of this.geoms) {
        const on = mesh.userData.index === index;
        if (Boolean(mesh.userData.lit) === on) continue;
        mesh.userData.lit = on;
        mesh.material.emissive.set(on ? P.color("found") || "#3aa0ff" : "#000000");
        mesh.material.emissiveIntensity = on ? 0.9 : 0;
        this.need();
      }
    }

    /** The geom under a place of the picture: its number in the list, where and how far, or null.
     * @param {number} x CSS pixels from the left @param {number} y from the top @returns {{index: number, point: any} | null} */
    pick(x, y) {
      const at = new THREE.Vector2((2 * x) / this.canvas.clientWidth - 1, 1 - (2 * y) / this.canvas.clientHeight);
      const ray = new THREE.Raycaster();
      ray.setFromCamera(at, this.camera);
      const enters = this.cutting.cutOn.value ? ray.ray.intersectBox(this.cut, new THREE.Vector3()) : null;
      const from = enters && !this.cut.containsPoint(ray.ray.origin) ? enters.distanceTo(ray.ray.origin) : 0;
      const hit = ray.intersectObjects(this.geoms.filter((m) => m.visible), false).find((h) => h.distance >= from);
      return hit ? { index: hit.object.userData.index, point: hit.point } : null;
    }

    /** Where a point of the world lies in the picture, CSS pixels from its top left corner, by the matrices of the drawing.
     * @param {ArrayLike<number>} point @returns {[number, number]} */
    project(point) {
      this.camera.updateMatrixWorld();
      const at = new THREE.Vector3(point[0], point[1], point[2]).project(this.camera);
      return [((at.x + 1) / 2) * this.canvas.clientWidth, ((1 - at.y) / 2) * this.canvas.clientHeight];
    }

    // ----- what flies -------------------------------------------------------------------------------------------------------

    /** A multirotor from where its rotors are.
     * @param {{rotors: number[][], radius?: number, bare?: boolean}} model rotors in the body's frame, m; `bare` for rotors alone
     * @param {{role: string, opacity?: number, halo?: boolean}} look `role` names a colour of the style sheet; `halo` draws a ring around
     *   it that does not shrink with the distance
     * @returns {any} a group with `place(pos, quat)` */
    addDrone(model, look) {
      const drone = new THREE.Group();
      const opacity = look.opacity ?? 1;
      const ghost = opacity < 1;
      const material = new THREE.MeshLambertMaterial({ transparent: ghost, opacity, depthWrite: !ghost });
      const nose = new THREE.MeshLambertMaterial({ transparent: ghost, opacity, depthWrite: !ghost });
      const disc = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.45 * opacity, side: THREE.DoubleSide, depthWrite: false });
      const reach = Math.max(...model.rotors.map((r) => Math.hypot(r[0], r[1])), 0.02);
      const radius = model.radius ?? 0.45 * reach;
      for (const [x, y, z] of model.rotors) {
        const arm = new THREE.Mesh(new THREE.BoxGeometry(Math.hypot(x, y), 0.09 * reach, 0.06 * reach), material);
        arm.position.set(x / 2, y / 2, z / 2);
        arm.rotation.z = Math.atan2(y, x);
        const rotor = new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, 0.02 * reach, 28), disc);
        rotor.rotation.x = Math.PI / 2;
        rotor.position.set(x, y, z + 0.08 * reach);
        drone.add(rotor);
        if (!model.bare) drone.add(arm);
      }
      if (!model.bare) drone.add(new THREE.Mesh(new THREE.BoxGeometry(0.5 * reach, 0.34 * reach, 0.2 * reach), material));
      const halo = look.halo ? ring() : null;
      if (halo) drone.add(halo);
      const tip = new THREE.Mesh(new THREE.ConeGeometry(0.12 * reach, 0.35 * reach, 16), nose);
      tip.rotation.z = -Math.PI / 2;
      tip.position.x = 0.42 * reach;
      drone.add(tip);
      P.onTheme(() => {
        material.color.set(P.color(look.role));
        disc.color.set(P.color(look.role));
        nose.color.set(P.color("mark"));
        halo?.material.color.set(P.color(look.role));
        this.need();
      });
      drone.place = (/** @type {ArrayLike<number>} */ pos, /** @type {ArrayLike<number>} */ quat) => {
        const there = [0, 1, 2].every((k) => Number.isFinite(pos[k])) && Number.isFinite(quat[0]);
        drone.visible = drone.userData.there = there;
        if (!there) return;
        drone.position.set(pos[0], pos[1], pos[2]);
        drone.quaternion.set(quat[0], quat[1], quat[2], quat[3]).normalize();
      };
      drone.userData.reach = reach;
      this.scene.add(drone);
      return drone;
    }

    /** A path with a colour for each of its points, and a dark or light edge that parts it from the scene.
     * @param {Float32Array} points n × 3, m; points with NaN break it
     * @param {{width?: number, role?: string, dashed?: boolean}} [look]
     * @returns {{colour(share: (k: number) => number): void, show(on: boolean): void, remove(): void}} */
    addPath(points, look = {}) {
      const n = points.length / 3;
      /** @type {number[][]} */
      const runs = [[]];
      for (let k = 0; k < n; k++) {
        if (Number.isFinite(points[3 * k] + points[3 * k + 1] + points[3 * k + 2])) runs[runs.length - 1].push(k);
        else if (runs[runs.length - 1].length) runs.push([]);
      }
      const width = look.width ?? 3;
      const material = new THREE.LineMaterial({ linewidth: width, vertexColors: !look.role, dashed: false });
      // Drawn before the line and without depth, so that it shows on both sides of it alone.
      const edge = new THREE.LineMaterial({ linewidth: width + 2, depthWrite: false });
      // A faint one shows where the path goes behind things.
      const through = new THREE.LineMaterial({
        linewidth: width, vertexColors: !look.role, transparent: true, opacity: 0.3, depthTest: false, depthWrite: false,
      });
      this.lines.push(material, edge, through);
      const group = new THREE.Group();
      const lines = runs.filter((r) => r.length > 1).map((run) => {
        const shape = new THREE.LineGeometry();
        shape.setPositions(run.flatMap((k) => [points[3 * k], points[3 * k + 1], points[3 * k + 2]]));
        const under = new THREE.Line2(shape, edge);
        const line = new THREE.Line2(shape, material);
        under.renderOrder = 1;
        line.renderOrder = 2;
        const behind = new THREE.Line2(shape, through);
        behind.renderOrder = 3;
        if (!look.role) group.add(under);
        group.add(line, behind);
        return { run, shape };
      });
      this.scene.add(group);
      P.onTheme(() => {
        edge.color.set(P.color("space-edge") || "#0b0e12");
        if (look.role) [material, through].forEach((m) => m.color.set(P.color(look.role)));
        this.need();
      });
      this.resize();
      return {
        colour: (share) => {
          for (const { run, shape } of lines) {
            const color = new THREE.Color();
            shape.setColors(run.flatMap((k) => {
              const [r, g, b] = P.cividis(share(k));
              color.setRGB(r, g, b, THREE.SRGBColorSpace);
              return [color.r, color.g, color.b];
            }));
          }
          this.need();
        },
        show: (on) => {
          group.visible = on;
          this.need();
        },
        remove: () => {
          this.scene.remove(group);
          lines.forEach((l) => l.shape.dispose());
          this.lines = this.lines.filter((m) => m !== material && m !== edge && m !== through);
          this.need();
        },
      };
    }

    /** An arrow, such as a force. @param {string} role @returns {{set(from: ArrayLike<number>, vector: ArrayLike<number>): void, object: any}} */
    addArrow(role) {
      const arrow = new THREE.ArrowHelper(new THREE.Vector3(1, 0, 0), new THREE.Vector3(), 1);
      arrow.visible = false;
      P.onTheme(() => arrow.setColor(new THREE.Color(P.color(role))));
      this.scene.add(arrow);
      return {
        object: arrow,
        set: (from, vector) => {
          const along = new THREE.Vector3(vector[0], vector[1], vector[2]);
          const length = along.length();
          arrow.visible = length > 1e-3 && Number.isFinite(from[0]);
          if (!arrow.visible) return;
          arrow.position.set(from[0], from[1], from[2]);
          arrow.setDirection(along.divideScalar(length));
          arrow.setLength(length, Math.min(0.3 * length, 0.15), Math.min(0.16 * length, 0.08));
        },
      };
    }

    /** A ring about an axis, such as a torque: a part of a circle by the right hand, with a head.
     * @param {string} role @returns {{set(from: ArrayLike<number>, axis: ArrayLike<number>, radius: number): void, object: any}} */
    addRing(role) {
      const ring = new THREE.Group();
      const material = new THREE.MeshBasicMaterial();
      const arc = 1.6 * Math.PI;
      const head = new THREE.Mesh(new THREE.ConeGeometry(0.09, 0.28, 14), material);
      head.position.set(Math.cos(arc), Math.sin(arc), 0);
      head.rotation.z = arc;
      ring.add(new THREE.Mesh(new THREE.TorusGeometry(1, 0.03, 8, 48, arc), material), head);
      ring.visible = false;
      P.onTheme(() => material.color.set(P.color(role)));
      this.scene.add(ring);
      return {
        object: ring,
        set: (from, axis, radius) => {
          const along = new THREE.Vector3(axis[0], axis[1], axis[2]);
          const length = along.length();
          ring.visible = length > 1e-12 && radius > 1e-3 && Number.isFinite(from[0]);
          if (!ring.visible) return;
          ring.position.set(from[0], from[1], from[2]);
          ring.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), along.divideScalar(length));
          ring.scale.setScalar(radius);
        },
      };
    }

    // ----- cameras ----------------------------------------------------------------------------------------------------------

    /** Puts the camera so that a box is in the picture. @param {number[]} low @param {number[]} high */
    frame(low, high) {
      const box = new THREE.Box3(new THREE.Vector3(...low), new THREE.Vector3(...high));
      const ball = box.getBoundingSphere(new THREE.Sphere());
      const half = (0.5 * this.camera.fov * Math.PI) / 180;
      const distance = (0.85 * Math.max(ball.radius, 0.3)) / Math.sin(Math.min(half, Math.atan(Math.tan(half) * this.camera.aspect)));
      this.controls.target.copy(ball.center);
      this.camera.position.copy(ball.center).add(new THREE.Vector3(-0.5, -0.75, 0.55).normalize().multiplyScalar(distance));
      this.controls.update();
      this.need();
    }

    /** How the camera moves: one of the buttons of `viewButtons`. @param {string} view */
    setView(view) {
      const was = this.view;
      // Orbit goes back to where it was.
      if (was === "orbit") this.kept = { at: this.camera.position.clone(), to: this.controls.target.clone() };
      this.view = VIEWS.includes(view) ? view : "orbit";
      this.controls.enabled = this.view !== "first person";
      this.camera.up.set(0, 0, 1);
      if (this.target) this.lastTarget.copy(this.target.position);
      if (this.view === "follow" && this.target) {
        const away = this.camera.position.clone().sub(this.controls.target);
        const reach = Math.max(12 * this.target.userData.reach, 0.8);
        if (was === "first person" || was === "top" || !away.length()) away.set(-0.8, -0.3, 0.5);
        this.controls.target.copy(this.target.position);
        this.camera.position.copy(this.target.position).add(away.setLength(reach));
      } else if (this.view === "top") {
        const distance = this.kept ? this.kept.at.distanceTo(this.kept.to) : this.camera.position.distanceTo(this.controls.target);
        if (this.target?.userData.there) this.controls.target.copy(this.target.position);
        this.camera.position.copy(this.controls.target).add(new THREE.Vector3(0, -0.002 * distance, distance));
      } else if (this.view === "orbit" && was !== "orbit" && this.kept) {
        this.camera.position.copy(this.kept.at);
        this.controls.target.copy(this.kept.to);
      }
      this.camera.fov = (this.view === "first person" && this.mount?.fov) || FOV;
      this.camera.updateProjectionMatrix();
      if (this.view !== "first person") this.controls.update();
      this.moved();
      this.changed?.();
      this.buttons?.forEach((b) => b.setAttribute("aria-pressed", String(b.dataset.view === this.view)));
    }

    /** To be called when what is followed has moved. */
    moved() {
      const at = this.target;
      if (at?.userData.there) {
        if (this.view === "follow") {
          const step = at.position.clone().sub(this.lastTarget);
          this.camera.position.add(step);
          this.controls.target.add(step);
        } else if (this.view === "first person") {
          const place = new THREE.Vector3();
          const turn = new THREE.Quaternion();
          if (this.mount) {
            place.fromArray(this.mount.pos);
            turn.fromArray(this.mount.quat);
          } else {
            // Looks along the body's x, its z up; a camera looks along its own −z.
            place.set(0.5 * at.userData.reach, 0, 0);
            turn.set(0.5, -0.5, -0.5, 0.5);
          }
          this.camera.position.copy(place.applyQuaternion(at.quaternion).add(at.position));
          this.camera.quaternion.copy(at.quaternion).multiply(turn);
        }
        this.lastTarget.copy(at.position);
        at.visible = this.view !== "first person";
      }
      this.need();
    }

    /** Buttons for the ways in which the camera moves. @param {boolean} [moving] whether there is something to follow */
    viewButtons(moving = true) {
      /** @type {any[]} */
      this.buttons = (moving ? VIEWS : ["orbit", "top"]).map((view) => P.el("button", {
        type: "button", "data-view": view, "aria-pressed": String(view === this.view), onclick: () => this.setView(view),
      }, view[0].toUpperCase() + view.slice(1)));
      return P.el("div", { class: "buttons", role: "group", "aria-label": "camera" }, ...this.buttons);
    }

    /** With the picture in focus: a and d go round, w and s over, + and − nearer and farther. @param {KeyboardEvent} event */
    turn(event) {
      if (this.pilot?.(event)) return;
      const away = this.camera.position.clone().sub(this.controls.target);
      const up = new THREE.Vector3(0, 0, 1);
      const side = up.clone().cross(away).normalize();
      const lift = Math.asin(away.z / Math.max(away.length(), 1e-9));
      if (event.key === "a" || event.key === "d") away.applyAxisAngle(up, event.key === "a" ? -0.1 : 0.1);
      else if (event.key === "w" && lift < 1.45) away.applyAxisAngle(side, -0.1);
      else if (event.key === "s" && lift > -1.45) away.applyAxisAngle(side, 0.1);
      else if (event.key === "+" || event.key === "=") away.multiplyScalar(0.85);
      else if (event.key === "-") away.multiplyScalar(1 / 0.85);
      else return;
      this.camera.position.copy(this.controls.target).add(away);
      this.controls.update();
      this.need();
      event.preventDefault();
    }

    /** The camera as text for an address, and back. @returns {string} */
    cameraText() {
      const at = [...this.camera.position.toArray(), ...this.controls.target.toArray()];
      return [this.view.replace(" ", "-"), ...at.map((v) => v.toFixed(3))].join(",");
    }

    /** @param {string | null} text */
    cameraFrom(text) {
      const [view, ...at] = (text ?? "").split(",");
      const numbers = at.map(Number);
      if (numbers.length !== 6 || !numbers.every((v) => Number.isFinite(v) && Math.abs(v) < 1e4)) return;
      this.setView(view.replace("-", " "));
      this.camera.position.fromArray(numbers);
      this.controls.target.fromArray(numbers, 3);
      if (this.view !== "first person") this.controls.update();
      this.moved();
    }
  }
  P.Scene3D = Scene3D;

  /** The shape of a geom that has no triangles of its own, in its frame. @param {string} kind @param {number[]} size as in MJCF, m */
  function primitive(kind, size) {
    const [a, b, c] = size;
    /** @type {any} */
    let shape;
    if (kind === "plane") shape = new THREE.PlaneGeometry(2 * (a || FAR_PLANE), 2 * (b || FAR_PLANE));
    else if (kind === "sphere") shape = new THREE.SphereGeometry(a, 32, 20);
    else if (kind === "ellipsoid") shape = new THREE.SphereGeometry(1, 32, 20);
    else if (kind === "box") shape = new THREE.BoxGeometry(2 * a, 2 * b, 2 * c);
    else if (kind === "capsule") shape = new THREE.CapsuleGeometry(a, 2 * b, 10, 28).rotateX(Math.PI / 2);
    else if (kind === "cylinder") shape = new THREE.CylinderGeometry(a, a, 2 * b, 32).rotateX(Math.PI / 2);
    else throw new Error(`a geom of the kind ${kind} has no shape of its own`);
    return shape;
  }

  /** Lines on a plane, one a metre, so that one sees how large things are. @param {number[]} size */
  function metres(size) {
    const [a, b] = [size[0] || FAR_PLANE, size[1] || FAR_PLANE];
    const points = [];
    for (let x = Math.ceil(-a); x <= a; x++) points.push(x, -b, 0.002, x, b, 0.002);
    for (let y = Math.ceil(-b); y <= b; y++) points.push(-a, y, 0.002, a, y, 0.002);
    const shape = new THREE.BufferGeometry();
    shape.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
    return new THREE.LineSegments(shape, new THREE.LineBasicMaterial({ color: 0x20262e, transparent: true, opacity: 0.3 }));
  }

  /** A ring of 26 pixels around a point, before everything. */
  function ring() {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = 64;
    const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    pen.strokeStyle = "#fff";
    pen.lineWidth = 5;
    pen.arc(32, 32, 28, 0, 2 * Math.PI);
    pen.stroke();
    const shape = new THREE.BufferGeometry();
    shape.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3), 3));
    return new THREE.Points(shape, new THREE.PointsMaterial({
      map: new THREE.CanvasTexture(canvas), size: 26 * Math.min(2, devicePixelRatio), sizeAttenuation: false, transparent: true,
      opacity: 0.9, depthTest: false, depthWrite: false,
    }));
  }

  /** The edges of a shape, as a line. @param {any} shape */
  function outline(shape) {
    const material = new THREE.LineBasicMaterial();
    P.onTheme(() => material.color.set(P.color("unseen") || "#ff5fa2"));
    return new THREE.LineSegments(new THREE.EdgesGeometry(shape, 25), material);
  }

  /** A pose between two of a track: places by a straight line, turns by slerp.
   * @param {{t: ArrayLike<number>, pos: ArrayLike<number>, quat: ArrayLike<number>}} track @param {number} time
   * @returns {{pos: number[], quat: number[], k: number}} */
  P.poseAt = (track, time) => {
    const k = Math.min(P.before(track.t, time), Math.max(track.t.length - 2, 0));
    const next = Math.min(k + 1, track.t.length - 1);
    const share = next === k ? 0 : Math.min(Math.max((time - track.t[k]) / (track.t[next] - track.t[k]), 0), 1);
    const pos = [0, 1, 2].map((c) => track.pos[3 * k + c] + share * (track.pos[3 * next + c] - track.pos[3 * k + c]));
    const of = (/** @type {number} */ n) => new THREE.Quaternion(track.quat[4 * n], track.quat[4 * n + 1], track.quat[4 * n + 2], track.quat[4 * n + 3]);
    const turn = of(k).normalize().slerp(of(next).normalize(), share);
    return { pos, quat: turn.toArray(), k };
  };
})();

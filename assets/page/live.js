"use strict";
// The living part of a report: effects with switches and sliders, and what they change: figures, curves, dots, the strip, the flight in 3-D.
// Residuals are r = r₀ + Σ s·D, with s = 0 at the vehicle file's values and 1 at the estimates.
(() => {
  const P = (globalThis.Propwash ??= {});

  /** Puts the living part into a page. `live` is its data; `page` says where things go (`root`, `times`, `causes`, `tools`) and, in the lab, what
   * else there is: `scene` (the data of what stands around the flight), `head` and `foot` (elements above and below the effects), `searched` (whether a
   * search was made), `changed` (called after the person turned an effect or moved a slider), `windowed` (after another window).
   * Gives a handle by which the lab puts in what its engine says. */
  P.living = (live, page) => {
    const { root } = page;
    const forget = P.themes();
    /** What the engine says of the present values, where it has said so: figures by name. */
    let exact = null;

    const AXES = ["x", "y", "z"];
    const ABOUT = ["roll", "pitch", "yaw"];
    const SLIDER = 200;
    const effects = live.effects.map((e) => ({ ...e, on: false, shares: e.handles.map(() => 1) }));
    const shares = new Float64Array(live.force.g.length);

    // ----- numbers --------------------------------------------------------------------------------------------------------------

    /** The arrays of a flight, read when it is first shown. */
    function unpacked(flight) {
      if (flight.data) return flight.data;
      const some = (spec) => (spec ? P.array(spec) : null);
      const d = {
        t: P.array(flight.t), judged: P.array(flight.judged), force: P.array(flight.force), torque: some(flight.torque),
        changes: flight.changes.map((c) => ({ force: some(c.force), torque: some(c.torque) })),
        causes: flight.causes.map((c) => ({ ...c, values: P.array(c.values) })),
      };
      d.nowForce = new Float32Array(d.force.length);
      d.nowTorque = d.torque ? new Float32Array(d.torque.length) : null;
      flight.data = d;
      return d;
    }

    /** Σ of the effects that are on, for the flight that is shown. */
    function recompute() {
      const add = (now, then, which) => {
        now.set(then);
        for (let h = 0; h < shares.length; h++) {
          const change = shares[h] ? data.changes[h][which] : null;
          if (change) for (let k = 0; k < now.length; k++) now[k] += shares[h] * change[k];
        }
      };
      add(data.nowForce, data.force, "force");
      if (data.torque) add(data.nowTorque, data.torque, "torque");
    }

    /** Root mean square on the judged flight, by its sums. */
    function whole(form, s) {
      let sum = form.c;
      for (let a = 0; a < s.length; a++) {
        if (!s[a]) continue;
        sum += 2 * form.g[a] * s[a];
        for (let b = 0; b < s.length; b++) sum += s[a] * s[b] * form.h[a][b];
      }
      return form.n ? Math.sqrt(Math.max(sum, 0) / form.n) : NaN;
    }

    /** Root mean square in the window. */
    function inWindow(values) {
      let sum = 0;
      let n = 0;
      for (let k = 0; k < data.t.length; k++) {
        if (data.t[k] < win[0] || data.t[k] > win[1] || !Number.isFinite(values[3 * k])) continue;
        sum += values[3 * k] ** 2 + values[3 * k + 1] ** 2 + values[3 * k + 2] ** 2;
        n++;
      }
      return n ? Math.sqrt(sum / n) : NaN;
    }

    // ----- what is shown --------------------------------------------------------------------------------------------------------

    let flight = live.flights[0];
    let data = unpacked(flight);
    /** The stretch that is looked at, s, or none. @type {[number, number] | null} */
    let win = null;
    const limits = () => [flight.path.t0, flight.path.t1];
    for (const f of live.flights) {
      f.path.times = P.array(f.path.measured.t);
      [f.path.t0, f.path.t1] = [f.path.times[0], f.path.times[f.path.times.length - 1]];
    }
    const player = new P.Player(...limits());
    const torques = live.torque.n > 0;

    // ----- figures --------------------------------------------------------------------------------------------------------------

    const figures = P.el("div", { class: "figures" });
    const where = P.el("p", { class: "small where" });
    const made = {};
    for (const [which, title, unit] of [["force", "force the model lacks", "N"], ["torque", "torque the model lacks", "N·m"]]) {
      if (which === "torque" && !torques) continue;
      const before = P.el("span", { class: "was" });
      const now = P.el("output", { class: "now", id: which + "-now" });
      figures.append(P.el("div", { class: "figure" }, P.el("span", { class: "what" }, title), P.el("span", {}, before, now)));
      made[which] = { before, now, unit };
    }

    /** Whether a figure with these effects is only near the model's own. */
    function near() {
      const on = effects.filter((e) => e.on);
      if (on.some((e) => e.shares.some((s) => s !== 0 && s !== 1 && (s < e.trust[0] || s > e.trust[1])))) return true;
      const checked = on.every((e) => e.role === "found") && (live.together_off ?? 0) <= 0.05;
      return on.length > 1 && !checked;
    }

    function tell() {
      const about = !exact && (page.changed ? shares.some((s) => s !== 0) : near()) ? "≈ " : "";
      const none = new Float64Array(shares.length);
      for (const [which, m] of Object.entries(made)) {
        const pair = win
          ? [inWindow(data[which]), inWindow(which === "force" ? data.nowForce : data.nowTorque)]
          : [whole(live[which], none), whole(live[which], shares)];
        if (exact?.[which] !== undefined) pair[1] = exact[which];
        const scale = P.scaled(Math.max(...pair.filter(Number.isFinite), 0), m.unit);
        m.before.textContent = effects.some((e) => e.on) ? P.short(pair[0] * scale.factor) + " → " : "";
        m.now.textContent = about + P.short(pair[1] * scale.factor) + " " + scale.unit;
        m.now.dataset.si = String(pair[1]);
      }
      const [from, to] = limits();
      where.textContent = win
        ? `${(win[1] - win[0]).toFixed(1)} s of ${(to - from).toFixed(1)} s of ${flight.log}, from ${win[0].toFixed(1)} to ${win[1].toFixed(1)} s`
        : `on ${live.judged_on}`;
      where.textContent += about ? "; ≈: straight line, not run through the model with these values" : "";
    }

    // ----- effects --------------------------------------------------------------------------------------------------------------

    const moment = P.el("span", { class: "small", id: "redrawn" });

    /** Everything again after a change of an effect. */
    function update() {
      const begin = performance.now();
      exact = null;
      shares.fill(0);
      for (const e of effects) {
        e.show?.();
        if (e.on) e.handles.forEach((h, k) => (shares[h.change] += e.shares[k]));
      }
      recompute();
      tell();
      drawn.forEach((part) => part.update());
      moment.textContent = `redrawn in ${(performance.now() - begin).toFixed(1)} ms`;
      moment.dataset.ms = String(performance.now() - begin);
    }

    const valueOf = (h, share) => h.filed + share * (h.value - h.filed);
    const words = (h, share) => P.short(valueOf(h, share) * h.factor) + (h.unit ? " " + h.unit : "");

    /** What an effect alone does at its estimate. */
    function alone(e) {
      const s = new Float64Array(shares.length);
      e.handles.forEach((h) => (s[h.change] = 1));
      const none = new Float64Array(shares.length);
      const list = ["force", "torque"].filter((w) => live[w].n).map((w) => [w, whole(live[w], none), whole(live[w], s)]);
      list.sort((a, b) => a[2] / a[1] - b[2] / b[1]);
      const [which, a, b] = list[0];
      const scale = P.scaled(Math.max(a, b), which === "force" ? "N" : "N·m");
      return `alone: ${which} ${P.short(a * scale.factor)} → ${P.short(b * scale.factor)} ${scale.unit}`;
    }

    /** A slider with the estimate and its 95 % interval as marks. */
    function slider(e, k) {
      const h = e.handles[k];
      const step = h.value - h.filed;
      const ends = h.range.map((v) => (v - h.filed) / step).sort((a, b) => a - b);
      const place = (share) => `calc(11px + ${Math.min(Math.max((share - ends[0]) / (ends[1] - ends[0]), 0), 1)} * (100% - 22px))`;
      const input = P.el("input", {
        type: "range", min: Math.round(ends[0] * SLIDER), max: Math.round(ends[1] * SLIDER), step: 1, value: SLIDER,
        "aria-label": `${e.id}: ${h.name}`,
      });
      const told = P.el("output", { class: "value" });
      const marks = P.el("div", { class: "marks", "aria-hidden": "true" });
      if (h.sigma) {
        const half = (1.96 * h.sigma) / Math.abs(step);
        const band = P.el("i", { class: "band" });
        band.style.left = place(1 - half);
        band.style.right = `calc(100% - ${place(1 + half)})`;
        marks.append(band);
      }
      for (const [share, name] of [[0, "file"], [1, "estimate"]]) {
        const mark = P.el("i", { class: name });
        mark.style.left = place(share);
        marks.append(mark);
      }
      const snap = () => set(1);
      const set = (share) => {
        e.shares[k] = share;
        e.on = true;
        update();
        page.changed?.({ kind: "slider", effect: e, handle: h, value: valueOf(h, share) });
      };
      input.addEventListener("input", () => set(Number(input.value) / SLIDER));
      input.addEventListener("dblclick", snap);
      const reset = P.el("button", { type: "button", class: "reset", title: "back to the estimate", "aria-label": `Reset ${e.id}: ${h.name}`,
        onclick: snap }, "Reset");
      const name = h.share ? h.name : P.el("code", {}, h.name);
      const show = () => {
        const share = e.shares[k];
        input.value = Math.round(share * SLIDER);
        const about = share !== 0 && share !== 1 && (share < e.trust[0] || share > e.trust[1]) ? "≈ " : "";
        told.textContent = about + words(h, share);
        input.setAttribute("aria-valuetext", `${words(h, share)}, ${Math.round(100 * share)} % of the way from the file to the estimate`);
      };
      const element = P.el("div", { class: "slider" }, P.el("span", { class: "name" }, name, told),
        P.el("span", { class: "track" }, input, marks), reset, P.el("span", { class: "small estimate" }, "estimate " + h.words));
      return { element, show };
    }

    function row(e) {
      const box = P.el("input", { type: "checkbox", class: "on" });
      box.addEventListener("change", () => {
        e.on = box.checked;
        update();
        page.changed?.({ kind: "switch", effect: e });
      });
      const sliders = e.handles.map((_, k) => slider(e, k));
      e.show = () => {
        box.checked = e.on;
        element.classList.toggle("is-on", e.on);
        sliders.forEach((s) => s.show());
      };
      const name = e.role === "correction" ? P.el("b", {}, e.id) : P.el("code", {}, e.id);
      const note = [e.note, alone(e)].filter(Boolean).join(" · ");
      const element = P.el("div", { class: "effect", "data-effect": e.id },
        P.el("label", { class: "switch" }, box, P.el("span", {}, name, " ", P.el("span", { class: "small" }, e.title))),
        P.el("p", { class: "small" }, note), ...sliders.map((s) => s.element));
      if (e.trust[1] < 2 || e.trust[0] > 0) {
        const to = e.trust[0] > 0 ? "at the estimate alone" : "up to the estimate";
        element.append(P.el("p", { class: "small" }, `≈: not a straight line; within 5 % ${to}, off by up to ${Math.round(100 * e.off)} % at twice it`));
      }
      return element;
    }

    /** The switches in the order of the panel. */
    const panelBoxes = () => [...root.querySelectorAll(".effect .on")];

    function effectsPanel() {
      const panel = P.el("div", { class: "effects", id: "effects" }, page.head ?? "");
      if (!effects.length) return panel.append(page.foot ?? ""), panel;
      panel.append(P.el("h3", {}, "Effects"));
      const all = (role) => effects.filter((e) => e.role === role);
      const turn = (on) => {
        effects.forEach((e) => {
          e.on = on && e.role === "found";
          e.shares.fill(1);
        });
        update();
        page.changed?.({ kind: "all", effects: effects.filter((e) => e.on) });
      };
      const buttons = P.el("div", { class: "buttons" });
      if (all("found").length) buttons.append(P.el("button", { type: "button", onclick: () => turn(true) }, "All that was found"));
      buttons.append(P.el("button", { type: "button", onclick: () => turn(false) }, "All off"));
      panel.append(buttons, ...all("found").map(row));
      if (!all("found").length && page.searched !== false) panel.append(P.el("p", { class: "small" }, "Nothing was found that is missing. What was tried can be turned on below; it proves nothing."));
      for (const [role, title] of [
        ["correction", "Small corrections, within tolerance"], ["look_alike", "What looks alike"], ["candidate", "Other candidates, each alone"],
      ]) {
        if (!all(role).length) continue;
        panel.append(P.el("details", {}, P.el("summary", {}, `${title} (${all(role).length})`), ...all(role).map(row)));
      }
      panel.append(moment, page.foot ?? "");
      return panel;
    }

    // ----- plots ----------------------------------------------------------------------------------------------------------------

    /** What draws itself again after a change, with `update`, and after another flight or window, with `renew`. */
    const drawn = [];

    /** Calls `then` at once while an element can be seen, else when it comes into sight. */
    function whenSeen(element, then) {
      let seen = true;
      let due = false;
      new IntersectionObserver((list) => {
        seen = list.some((e) => e.isIntersecting);
        if (seen && due) {
          due = false;
          then();
        }
      }, { rootMargin: "100px" }).observe(element);
      return () => {
        if (seen) then();
        else due = true;
      };
    }

    const KEY = "lab";
    /** Where lines break, and where nothing is known: further than this from a sample, s. Long flights have fewer samples. */
    const hole = () => Math.max(0.3, (4 * (data.t[data.t.length - 1] - data.t[0])) / data.t.length);

    function timePlot(which, axis) {
      const at = P.el("div", { class: "plot" });
      const name = which === "force" ? `force along body ${AXES[axis]}` : `torque about body ${AXES[axis]}`;
      const caption = P.el("figcaption");
      let plot = null;
      let scale = { factor: 1, unit: "" };
      let places = [];
      const column = (values) => places.map((k) => (k < 0 || !Number.isFinite(values[3 * k + axis]) ? null : values[3 * k + axis] * scale.factor));
      const now = () => (which === "force" ? data.nowForce : data.nowTorque);
      const most = (list) => list.reduce((m, v) => (v === null ? m : Math.max(m, Math.abs(v))), 0);
      let [times, before] = [[], []];
      let reach = 1;
      const update = whenSeen(at, () => {
        if (!plot) return;
        const values = column(now());
        reach = Math.max(most(before), most(values)) * 1.05 || 1;
        plot.setData([times, before, values], false);
        plot.setScale("y", { min: -reach, max: reach });
        if (twin.open) twin.fill();
      });
      const twin = P.twin(name, () => [["t, s", ...["before", "now"].map((w) => `${w}, ${scale.unit}`)],
        ...P.every(times.length).map((k) => [times[k].toFixed(2), P.short(before[k] ?? NaN), P.short(column(now())[k] ?? NaN)])]);
      const renew = () => {
        plot?.destroy();
        const source = data[which];
        at.parentElement.hidden = !source;
        if (!source) return (plot = null);
        places = [];
        for (let k = 0; k < data.t.length; k++) {
          if (k && data.t[k] - data.t[k - 1] > hole()) places.push(-1);
          places.push(k);
        }
        times = places.map((k, i) => (k < 0 ? data.t[places[i - 1]] + 1e-3 : data.t[k]));
        let size = 0;
        for (let k = axis; k < source.length; k += 3) if (Number.isFinite(source[k])) size = Math.max(size, Math.abs(source[k]));
        scale = P.scaled(size, which === "force" ? "N" : "N·m");
        caption.replaceChildren(name, P.el("span", {}, ` ${scale.unit}`));
        before = column(source);
        const sigma = (which === "force" ? flight.force_sigma : flight.torque_sigma)[axis] * scale.factor * 1.96;
        const mark = (u) => {
          u.ctx.fillStyle = P.tint("mark");
          u.ctx.fillRect(u.valToPos(player.time, "x", true) - devicePixelRatio, u.bbox.top, 2 * devicePixelRatio, u.bbox.height);
        };
        const worst = flight.worst.map((w, k) => [w.from_s, w.to_s, String(k + 1)]);
        const x = win ?? limits();
        plot = new uPlot({
          width: Math.max(at.clientWidth, 160), height: 170, legend: { show: false },
          cursor: { sync: { key: KEY, setSeries: false }, y: false, drag: { x: true, y: false, setScale: false },
            bind: { dblclick: () => () => setWindow(null) } },
          scales: { x: { time: false, min: x[0], max: x[1], auto: false }, y: { auto: false, range: () => [-reach, reach] } },
          axes: P.axes("", ""),
          series: [{}, { label: "before", stroke: () => P.tint("filed"), width: 1.2, points: { show: false } },
            { label: "now", stroke: () => P.tint("found"), width: 1.6, points: { show: false } }],
          hooks: {
            drawAxes: [P.behind(worst, sigma)], draw: [mark],
            setSelect: [(u) => {
              if (u.select.width > 4) setWindow([u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x")]);
              u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
            }],
          },
        }, [times, before, before], at);
        plot.root.setAttribute("aria-hidden", "true");
        plot.over.addEventListener("click", (event) => player.set(plot.posToVal(event.offsetX, "x")));
        plot.setScale("x", { min: x[0], max: x[1] });
        update();
      };
      new ResizeObserver(() => plot && at.clientWidth && plot.setSize({ width: at.clientWidth, height: 170 })).observe(at);
      const redraw = whenSeen(at, () => plot?.redraw(false, false));
      player.on(redraw);
      P.onTheme(redraw);
      drawn.push({ update, renew, window: () => plot?.setScale("x", { min: (win ?? limits())[0], max: (win ?? limits())[1] }) });
      return P.el("figure", {}, caption, at, twin);
    }

    const RESIDUALS = [
      ...AXES.map((a) => ["force_body_" + a, "force along body " + a]), ["force_along_velocity", "force along the velocity"],
      ...(torques ? AXES.map((a) => ["torque_body_" + a, "torque about body " + a]) : []),
    ];

    /** A residual at sample k, SI. */
    function residual(name, force, torque) {
      const axis = AXES.indexOf(name.at(-1));
      if (name.startsWith("torque")) return (k) => (torque ? torque[3 * k + axis] : NaN);
      if (name !== "force_along_velocity") return (k) => force[3 * k + axis];
      const along = ["velocity_forward", "velocity_left", "velocity_up"].map((n) => data.causes.find((c) => c.name === n)?.values);
      return (k) => {
        const v = along.map((list) => (list ? list[k] : NaN));
        const speed = Math.hypot(...v);
        return speed > 0.1 ? (force[3 * k] * v[0] + force[3 * k + 1] * v[1] + force[3 * k + 2] * v[2]) / speed : NaN;
      };
    }

    function choice(label, list, chosen, then) {
      const select = P.el("select", { "aria-label": label }, ...list.map(([value, title]) => P.el("option", { value, selected: value === chosen }, title)));
      select.addEventListener("change", () => then(select.value));
      return select;
    }

    /** A residual against an operating condition, as dots. */
    function causePlot(pair) {
      const at = P.el("div", { class: "plot" });
      let [name, of] = pair;
      let plot = null;
      let scale = { factor: 1, unit: "" };
      let order = [];
      let reach = 1;
      const cause = () => data.causes.find((c) => c.name === of) ?? data.causes[0];
      const values = (which) => {
        const [force, torque] = which === "before" ? [data.force, data.torque] : [data.nowForce, data.nowTorque];
        const value = residual(name, force, torque);
        return order.map((k) => {
          const v = value(k) * scale.factor;
          return Number.isFinite(v) ? v : null;
        });
      };
      const dots = (role, alpha, size) => (u, s) => {
        const r = size * devicePixelRatio;
        u.ctx.save();
        u.ctx.fillStyle = P.tint(role);
        u.ctx.globalAlpha = alpha;
        const [x, y] = [u.data[0], u.data[s]];
        // Places by hand: asking uPlot for each of some thousand takes longer than drawing them.
        const [x0, x1, y0, y1] = [u.scales.x.min, u.scales.x.max, u.scales.y.min, u.scales.y.max];
        const { left, top, width, height } = u.bbox;
        for (let k = 0; k < x.length; k++) {
          if (y[k] === null) continue;
          u.ctx.fillRect(left + ((x[k] - x0) / (x1 - x0)) * width - r, top + (1 - (y[k] - y0) / (y1 - y0)) * height - r, 2 * r, 2 * r);
        }
        u.ctx.restore();
        return null;
      };
      const update = whenSeen(at, () => {
        if (!plot) return;
        plot.setData([plot.data[0], plot.data[1], values("now")], false);
        plot.redraw(true, false);
        if (twin.open) twin.fill();
      });
      const bins = () => {
        const xs = order.map((k) => cause().values[k] * cause().factor);
        const [before, now] = [values("before"), values("now")];
        const n = Math.min(12, Math.floor(order.length / 4));
        const lines = Array.from({ length: n }, (_, b) => {
          const [from, to] = [Math.floor((b * order.length) / n), Math.floor(((b + 1) * order.length) / n)];
          const mean = (list) => {
            const part = list.slice(from, to).filter((v) => v !== null);
            return part.reduce((s, v) => s + v, 0) / part.length;
          };
          return [P.short(mean(xs)), P.short(mean(before)), P.short(mean(now))];
        });
        const unit = cause().unit;
        return [[cause().title + (unit ? ", " + unit : ""), `mean before, ${scale.unit}`, `mean now, ${scale.unit}`], ...lines];
      };
      const twin = P.twin("means in bins", bins);
      const renew = () => {
        plot?.destroy();
        const c = cause();
        const inside = (k) => (!win || (data.t[k] >= win[0] && data.t[k] <= win[1])) && Number.isFinite(c.values[k]);
        order = Array.from(data.t.keys()).filter(inside).sort((a, b) => c.values[a] - c.values[b]);
        scale = { factor: 1, unit: "" };
        const size = values("before").filter((v) => v !== null).map(Math.abs).sort((a, b) => a - b);
        // A few dots far away would press all others onto the line.
        scale = P.scaled(size[Math.floor(0.99 * size.length)] ?? 0, name.startsWith("torque") ? "N·m" : "N");
        reach = 1.25 * (size[Math.floor(0.99 * size.length)] ?? 1) * scale.factor || 1;
        const xs = order.map((k) => c.values[k] * c.factor);
        const edge = 0.03 * ((xs.at(-1) ?? 1) - (xs[0] ?? 0)) || 1;
        plot = new uPlot({
          width: Math.max(at.clientWidth, 160), height: 230, legend: { show: false }, cursor: { show: false },
          scales: { x: { time: false, range: () => [(xs[0] ?? 0) - edge, (xs.at(-1) ?? 1) + edge] }, y: { range: () => [-reach, reach] } },
          axes: P.axes(c.title + (c.unit ? ", " + c.unit : ""), scale.unit),
          series: [{}, { paths: dots("filed", 0.45, 1.3), points: { show: false } }, { paths: dots("found", 0.9, 1.3), points: { show: false } }],
          hooks: { drawAxes: [P.behind([], 0)] },
        }, [xs, values("before"), values("now")], at);
        plot.root.setAttribute("aria-hidden", "true");
      };
      new ResizeObserver(() => plot && at.clientWidth && plot.setSize({ width: at.clientWidth, height: 230 })).observe(at);
      const redraw = whenSeen(at, () => plot?.redraw(true, false));
      P.onTheme(redraw);
      drawn.push({ update, renew, window: renew });
      const pick = P.el("figcaption", { class: "pick" },
        choice("residual", RESIDUALS, name, (v) => {
          name = v;
          renew();
        }), P.el("span", {}, " against "),
        choice("operating condition", data.causes.map((c) => [c.name, c.title]), of, (v) => {
          of = v;
          renew();
        }));
      return P.el("figure", {}, pick, at, twin);
    }

    /** A window for everything, or none. */
    function setWindow(next) {
      const [from, to] = limits();
      win = next && [Math.max(Math.min(...next), from), Math.min(Math.max(...next), to)];
      if (win && win[1] - win[0] < 0.1) win = null;
      [fromBox.value, toBox.value] = (win ?? [from, to]).map((v) => v.toFixed(1));
      drawn.forEach((part) => part.window?.());
      tell();
      page.windowed?.(win);
    }
    const box = (label) => {
      const input = P.el("input", { type: "number", step: 0.1, "aria-label": label });
      input.addEventListener("change", () => setWindow([Number(fromBox.value), Number(toBox.value)]));
      return input;
    };
    const [fromBox, toBox] = [box("window from, s"), box("window to, s")];
    const windowBar = P.el("div", { class: "window" }, "Window from ", fromBox, " to ", toBox, " s ",
      P.el("button", { type: "button", onclick: () => setWindow(null) }, "Whole flight"));

    // ----- the flight in 3-D ----------------------------------------------------------------------------------------------------

    let colouring = "force";
    const size3 = (values, k) => Math.hypot(values[3 * k], values[3 * k + 1], values[3 * k + 2]);
    const nowOf = (which) => (which === "force" ? data.nowForce : data.nowTorque);

    /** A large value of a residual without effects: 98 of 100 are smaller. */
    function large(which) {
      const list = [];
      if (data[which]) for (let k = 0; k < data.t.length; k++) list.push(size3(data[which], k));
      const finite = list.filter(Number.isFinite).sort((a, b) => a - b);
      return finite[Math.floor(0.98 * (finite.length - 1))] || 1e-9;
    }

    /** Index of the sample at a time, or −1 where none is near. */
    function sampleAt(time) {
      let k = P.before(data.t, time);
      if (k + 1 < data.t.length && Math.abs(data.t[k + 1] - time) < Math.abs(data.t[k] - time)) k++;
      return Math.abs(data.t[k] - time) < hole() ? k : -1;
    }

    const told = P.el("p", { class: "small told", role: "status", id: "moment" });
    const caption = P.el("div", { class: "scale", "aria-hidden": "true" }, P.el("i"), P.el("span"));

    /** Turns a vector of the body into the world. */
    const turned = (quat, v) => new THREE.Vector3(...v).applyQuaternion(new THREE.Quaternion(...quat)).toArray();

    function direction(v) {
      const words = [["forward", "back"], ["left", "right"], ["up", "down"]];
      const axis = [0, 1, 2].reduce((a, b) => (Math.abs(v[b]) > Math.abs(v[a]) ? b : a));
      return words[axis][v[axis] > 0 ? 0 : 1];
    }

    /** An arrow with a body, which the path does not hide. @param {any} view @param {string} role */
    function boldArrow(view, role) {
      const material = new THREE.MeshBasicMaterial({ depthTest: false, transparent: true });
      const shaft = new THREE.Mesh(new THREE.CylinderGeometry(1, 1, 1, 12), material);
      const head = new THREE.Mesh(new THREE.ConeGeometry(2.6, 1, 16), material);
      const arrow = new THREE.Group().add(shaft, head);
      [shaft, head].forEach((m) => (m.renderOrder = 10));
      view.scene.add(arrow);
      P.onTheme(() => material.color.set(P.color(role)));
      return (from, vector, thick) => {
        const along = new THREE.Vector3(...vector);
        const length = along.length();
        arrow.visible = length > 1e-4 && Number.isFinite(from[0]);
        if (!arrow.visible) return;
        const tip = Math.min(7 * thick, 0.5 * length);
        shaft.scale.set(thick, length - tip, thick);
        shaft.position.set(0, (length - tip) / 2, 0);
        head.scale.set(thick, tip, thick);
        head.position.set(0, length - tip / 2, 0);
        arrow.position.set(...from);
        arrow.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along.divideScalar(length));
      };
    }

    function flightView() {
      const stage = P.el("div", { class: "stage" });
      let view;
      try {
        view = new P.Scene3D({ label: "The flight in three dimensions; the text under it tells the moment" });
      } catch {
        stage.append(P.el("p", { class: "small" }, "This browser draws no 3-D (WebGL): the flight is left out."));
        return { stage, tools: P.el("div"), place: () => {} };
      }
      P.scene = view;
      stage.append(view.canvas, caption);
      const model = { rotors: live.rotors.length ? live.rotors : [[0.1, 0, 0], [-0.1, 0, 0]], radius: live.rotor_radius_m || undefined };
      const measured = view.addDrone(model, { role: "drone", halo: true });
      const ghosts = { before: view.addDrone(model, { role: "filed", opacity: 0.55 }), after: view.addDrone(model, { role: "found", opacity: 0.55 }) };
      const force = boldArrow(view, "contact");
      const torque = view.addRing("mark");
      view.target = measured;
      if (page.scene) view.addScene(page.scene);
      const shown = { before: true, after: true };
      let [path, grid, tracks, factor] = [null, null, {}, 1];
      /** Lengths of arrows from afar, m/N and m/(N·m), and how much shorter they are beside the drone. */
      let [perNewton, perTorque, beside] = [1, 1, 1];
      const near = () => factor * (view.view === "follow" || view.view === "first person" ? beside : 1);
      let paint = () => {};

      function renew() {
        path?.remove();
        if (grid) view.scene.remove(grid);
        const read = (p) => p && { t: P.array(p.t), pos: P.array(p.pos), quat: P.array(p.quat) };
        tracks = { measured: read(flight.path.measured), before: read(flight.path.before), after: read(flight.path.after) };
        const pos = tracks.measured.pos;
        const box = [0, 1, 2].map((c) => {
          const list = Array.from({ length: pos.length / 3 }, (_, k) => pos[3 * k + c]).filter(Number.isFinite);
          return [Math.min(...list), Math.max(...list)];
        });
        const span = Math.max(...box.map(([a, b]) => b - a), 1);
        grid = page.scene ? null : view.addGrid(Math.ceil(1.6 * span), [(box[0][0] + box[0][1]) / 2, (box[1][0] + box[1][1]) / 2, Math.min(0, box[2][0])]);
        path = view.addPath(pos, { width: 4 });
        beside = Math.min((6 * measured.userData.reach) / (0.22 * span), 1);
        perNewton = (0.22 * span) / large("force");
        perTorque = data.torque ? (0.12 * span) / large("torque") : 0;
        view.frame(box.map((b) => b[0]), box.map((b) => b[1]));
        paint();
      }

      const nearest = () => Array.from(flight.path.times, sampleAt);
      let samples = [];
      paint = () => {
        const [values, most] = [nowOf(colouring) ?? data.nowForce, large(nowOf(colouring) ? colouring : "force")];
        path.colour((k) => (samples[k] < 0 ? NaN : size3(values, samples[k]) / most));
      };
      const seen = whenSeen(stage, () => paint());

      /** Puts everything where it is at the moment. */
      function place() {
        const time = player.time;
        const at = P.poseAt(tracks.measured, time);
        measured.place(at.pos, at.quat);
        for (const which of ["before", "after"]) {
          const track = tracks[which];
          if (!track || !shown[which]) {
            ghosts[which].visible = false;
            continue;
          }
          // Between two simulations there is none.
          const ghost = P.poseAt(track, time);
          ghosts[which].place(ghost.pos, ghost.quat);
        }
        const k = sampleAt(time);
        const vector = (values) => (k < 0 || !values ? [NaN, NaN, NaN] : [0, 1, 2].map((c) => values[3 * k + c]));
        const [f, m] = [vector(data.nowForce), vector(data.nowTorque)];
        force(at.pos, turned(at.quat, f).map((v) => v * perNewton * near()), 0.0022 * view.camera.position.distanceTo(measured.position));
        torque.set(at.pos, turned(at.quat, m), Math.hypot(...m) * perTorque * near());
        view.moved();
        bar();
      }

      /** How long an arrow of a round force is in the picture, at the drone. */
      function bar() {
        const away = view.camera.position.distanceTo(measured.position);
        const pixels = (view.canvas.clientHeight / 2 / Math.tan((view.camera.fov * Math.PI) / 360) / Math.max(away, 0.01)) * perNewton * near();
        const size = [1, 2, 5].flatMap((m) => [-4, -3, -2, -1, 0, 1, 2].map((p) => m * 10 ** p)).sort((a, b) => a - b)
          .findLast((n) => n * pixels <= 110) ?? 1e-4;
        caption.firstChild.style.width = `${Math.min(size * pixels, 120)}px`;
        const scale = P.scaled(size, "N");
        caption.children[1].textContent = `${P.number(size * scale.factor, "", 1)} ${scale.unit}`;
      }
      view.controls.addEventListener("change", bar);

      const ghost = (which, title) => {
        const input = P.el("input", { type: "checkbox", checked: true });
        input.addEventListener("change", () => {
          shown[which] = input.checked;
          place();
        });
        const line = P.el("i");
        line.style.setProperty("--role", `var(--${which === "before" ? "filed" : "found"})`);
        return P.el("label", { class: "ghost" }, input, line, title);
      };
      const arrows = choice("length of the arrows", [[0.5, "arrows × 0.5"], [1, "arrows × 1"], [2, "arrows × 2"], [4, "arrows × 4"]], 1, (v) => {
        factor = Number(v);
        place();
      });
      const colour = choice("colour of the path", [["force", "colour: missing force"], ...(torques ? [["torque", "colour: missing torque"]] : [])], "force", (v) => {
        colouring = v;
        paint();
        strip.draw();
      });
      const views = view.viewButtons();
      views.addEventListener("click", () => place());
      const tools = P.el("div", { class: "flight-tools" }, views, ghost("before", "model before"),
        live.flights.some((f) => f.path.after) ? ghost("after", "with all that was found") : "", arrows, colour);
      const boxes = tools.querySelectorAll(".ghost input");
      /** Ghosts off where any is on, else all on. */
      const haunt = () => {
        const on = ![...boxes].some((b) => b.checked);
        boxes.forEach((b) => b.checked !== on && b.click());
      };
      const follow = () => {
        const wanted = view.view === "follow" ? "orbit" : "follow";
        [...views.querySelectorAll("button")].find((b) => b.dataset.view === wanted)?.click();
      };
      drawn.push({
        update: () => {
          seen();
          place();
        },
        renew: () => {
          renew();
          samples = nearest();
          paint();
          place();
        },
      });
      return { stage, tools, place, view, haunt, follow };
    }

    let stripMost = 1;
    const strip = P.strip(player, {
      label: "What the model lacks over time, from little (dark) to much (yellow); the plots below have the numbers",
      share: (time) => {
        const k = sampleAt(time);
        return k < 0 ? NaN : size3(nowOf(colouring) ?? data.nowForce, k) / stripMost;
      },
      ticks: () => flight.worst.map((w) => w.from_s),
    });
    const drawStrip = whenSeen(strip.element, () => {
      stripMost = large(nowOf(colouring) ? colouring : "force");
      strip.draw();
    });
    drawn.push({ update: drawStrip, renew: drawStrip });

    // ----- the page -------------------------------------------------------------------------------------------------------------

    const three = flightView();
    let lastTold = 0;
    function tellMoment() {
      const now = performance.now();
      if (player.playing && now - lastTold < 1000) return;
      lastTold = now;
      const k = sampleAt(player.time);
      const start = `${player.time.toFixed(1)} s`;
      if (k < 0) {
        told.textContent = `${start}: nothing is known here`;
        return;
      }
      const f = [0, 1, 2].map((c) => data.nowForce[3 * k + c]);
      const size = Math.hypot(...f);
      const scale = P.scaled(size, "N");
      const speed = data.causes.find((c) => c.name === "speed")?.values[k];
      const parts = [start, speed === undefined ? "" : `${P.short(speed, 2)} m/s`, `missing force ${P.short(size * scale.factor)} ${scale.unit}, mostly ${direction(f)}`];
      if (data.nowTorque && Number.isFinite(data.nowTorque[3 * k])) {
        const m = [0, 1, 2].map((c) => data.nowTorque[3 * k + c]);
        const axis = [0, 1, 2].reduce((a, b) => (Math.abs(m[b]) > Math.abs(m[a]) ? b : a));
        const of = P.scaled(Math.hypot(...m), "N·m");
        parts.push(`missing torque ${P.short(Math.hypot(...m) * of.factor)} ${of.unit}, mostly in ${ABOUT[axis]}`);
      }
      told.textContent = parts.filter(Boolean).join(", ");
    }

    const logs = live.flights.length < 2 ? "" : choice("flight", live.flights.map((f, k) => [k, f.log]), 0, (v) => {
      flight = live.flights[Number(v)];
      data = unpacked(flight);
      win = null;
      recompute();
      player.limits(...limits());
      drawn.forEach((part) => part.renew());
      setWindow(null);
      update();
    });

    const fx = () => effects.flatMap((e, n) => (e.on ? [`${n}:${e.shares.map((s) => s.toFixed(3)).join(":")}`] : [])).join(",");
    if (page.tools) {
      page.tools.prepend(P.linkButton(() => ({ t: player.time.toFixed(2), fx: fx(), ...(three.view ? { cam: three.view.cameraText() } : {}) })));
    }

    root.append(figures, where, P.el("div", { class: "lab" },
      P.el("div", { class: "flight" }, logs, three.stage, three.tools, strip.element, player.controls(), told), effectsPanel()));
    page.times?.append(windowBar, P.el("div", { class: "plots" }, ...["force", ...(torques ? ["torque"] : [])].flatMap((w) => [0, 1, 2].map((a) => timePlot(w, a)))));
    const pairs = live.pairs.length ? live.pairs : [["force_along_velocity", "speed"], ["force_body_z", data.causes[0]?.name]];
    page.causes?.append(P.el("div", { class: "plots" }, ...pairs.map(causePlot)));

    // What the address asks for: a moment, a camera, effects.
    const asked = page.tools ? P.fragment() : new URLSearchParams();
    for (const word of (asked.get("fx") ?? "").split(",")) {
      const [n, ...list] = word.split(":").map(Number);
      const e = word && effects[n];
      if (!e || list.length !== e.shares.length || !list.every((s) => Number.isFinite(s) && Math.abs(s) <= 2)) continue;
      [e.on, e.shares] = [true, list];
    }
    recompute();
    drawn.forEach((part) => part.renew());
    setWindow(null);
    update();
    const left = new AbortController();
    player.keys(left.signal);
    document.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.altKey || event.metaKey || event.target.closest?.("input:not([type=range]):not([type=checkbox]), select, textarea, [contenteditable]")) return;
      const [from, to] = limits();
      const [a, b] = win ?? [from, to];
      const key = event.key.toLowerCase();
      if (key === "[") setWindow([player.time, Math.max(b, player.time + 0.1)]);
      else if (key === "]") setWindow([Math.min(a, player.time - 0.1), player.time]);
      else if (key === "f") three.follow?.();
      else if (key === "g") three.haunt?.();
      else if (key >= "1" && key <= "9") panelBoxes()[Number(key) - 1]?.click();
      else return;
      event.preventDefault();
    }, { signal: left.signal });
    player.on(() => {
      three.place();
      tellMoment();
    });
    three.view?.cameraFrom(asked.get("cam"));
    const first = flight.worst[0] ? 0.5 * (flight.worst[0].from_s + flight.worst[0].to_s) : player.from;
    player.set(Number(asked.get("t")) || first);
    drawn.push({ update: tellMoment, renew: tellMoment });
    document.querySelectorAll("button.jump").forEach((button) => button.addEventListener("click", () => {
      player.set(Number(button.dataset.at));
      player.speed = 0.5;
      root.scrollIntoView();
      if (!P.still()) player.play();
    }, { signal: left.signal }));

    /** Moves to other values in 200 ms, or at once where less motion is asked for. */
    function glide(targets) {
      const from = effects.map((e) => (e.on ? [...e.shares] : e.shares.map(() => 0)));
      const to = effects.map((e) => targets.get(e.id) ?? e.shares.map(() => 0));
      const begin = performance.now();
      const step = (now) => {
        const part = P.still() ? 1 : Math.min((now - begin) / 200, 1);
        effects.forEach((e, k) => {
          e.on = targets.has(e.id) || (part < 1 && from[k].some((s) => s !== 0));
          e.shares = part < 1 || targets.has(e.id) ? from[k].map((s, i) => s + part * (to[k][i] - s)) : e.shares.map(() => 1);
        });
        update();
        if (part < 1 && !left.signal.aborted) requestAnimationFrame(step);
        else settled?.();
      };
      settled = null;
      step(P.still() ? begin : begin + 16);
    }
    /** What waits for the end of a glide. */
    let settled = null;

    return {
      player, effects, update,
      /** The stretch that is looked at, or none. */
      window: () => win,
      /** Which flight is shown. */
      flight: () => live.flights.indexOf(flight),
      /** Another window for everything. */
      setWindow,
      /** Values of the effects that are on, by id: one share for each of their handles. Effects that are not named go off. */
      adopt: glide,
      /** Figures at the present values by the model itself (`force` N, `torque` N·m), and residuals of the flight that is shown. */
      settle(figures, arrays) {
        const then = () => {
          exact = figures;
          if (arrays?.force?.length === data.nowForce.length) data.nowForce.set(arrays.force);
          if (data.nowTorque && arrays?.torque?.length === data.nowTorque.length) data.nowTorque.set(arrays.torque);
          tell();
          if (arrays) drawn.forEach((part) => part.update());
        };
        then();
        settled = then;
      },
      /** Lets go of what outlives the elements: keys, colours, the picture in 3-D. */
      end() {
        left.abort();
        player.pause();
        forget();
        three.view?.end();
        P.scene = undefined;
      },
    };
  };

  const live = P.json("live");
  const root = document.getElementById("lab");
  if (live && root && live.flights.length) {
    P.living(live, { root, times: document.getElementById("lab-time"), causes: document.getElementById("lab-causes"), tools: document.querySelector(".tools") });
  }
})();

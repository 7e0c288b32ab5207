"use strict";
// The report of a comparison or a diagnosis: charts that the page carries as they are, by uPlot, each with a table behind a button; folded
// sections; the contents. What moves stands in `live.js`.
(() => {
  const P = (globalThis.Propwash ??= {});

  // Colours by name, asked for once and again after a change of theme: uPlot asks for them with every line.
  const colors = new Map();
  P.onTheme(() => colors.clear());
  P.tint = (role) => {
    if (!colors.has(role)) colors.set(role, P.color(role));
    return colors.get(role);
  };

  const RAISED = "⁰¹²³⁴⁵⁶⁷⁸⁹";
  /** A number with three significant digits; very large or small ones by a power of ten. */
  P.short = (value, digits = 3) => {
    if (!Number.isFinite(value)) return "–";
    const size = Math.abs(value);
    if (size === 0 || (size >= 1e-4 && size < 1e6)) return P.number(value, "", digits);
    const [mantissa, power] = value.toExponential(digits - 1).split("e");
    const raised = [...String(Number(power))].map((c) => (c === "-" ? "⁻" : RAISED[Number(c)])).join("");
    return mantissa.replace("-", "−") + "×10" + raised;
  };

  /** The prefix of an SI unit that suits a size: factor and unit. */
  P.scaled = (size, unit) => {
    if (!/^(m|s|N|V|A|W)([/·]|$)/.test(unit) || !(size > 0) || size >= 1) return { factor: 1, unit };
    if (size >= 0.999e-3) return { factor: 1e3, unit: "m" + unit };
    return size >= 0.999e-6 ? { factor: 1e6, unit: "µ" + unit } : { factor: 1, unit };
  };

  P.axes = (x, y) => [x, y].map((label, k) => ({
    label: label || undefined, labelSize: label ? 18 : 0, labelGap: 0, labelFont: "12px " + P.tint("text"), font: "12px " + P.tint("text"),
    size: k === 0 ? 30 : 52, gap: 4, space: k === 0 ? 55 : 26,
    stroke: () => P.tint("soft"), grid: { stroke: () => P.tint("grid"), width: 1 }, ticks: { show: false },
    values: (u, list) => list.map((v) => (v === null ? "" : P.short(v, 4).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, ""))),
  }));

  /** Calls a function once, when an element first comes near the window. */
  P.whenNear = (element, then) => {
    const seen = new IntersectionObserver((list) => {
      if (!list.some((e) => e.isIntersecting)) return;
      seen.disconnect();
      then();
    }, { rootMargin: "400px" });
    seen.observe(element);
  };

  const list = (array) => Array.from(array, (v) => (Number.isFinite(v) ? v : null));

  /** Points with error bars, drawn for one series. */
  function points(chart, traces) {
    return (u, s) => {
      const trace = traces[s - 1];
      const pen = u.ctx;
      const r = 3.5 * devicePixelRatio;
      pen.save();
      pen.strokeStyle = pen.fillStyle = P.tint(trace.role);
      pen.lineWidth = 1.4 * devicePixelRatio;
      trace.x.forEach((x, k) => {
        if (x === null || trace.y[k] === null) return;
        const [at, y] = [u.valToPos(x, "x", true), u.valToPos(trace.y[k], "y", true)];
        const half = trace.bars[k] ?? 0;
        pen.beginPath();
        pen.moveTo(at, u.valToPos(trace.y[k] - half, "y", true));
        pen.lineTo(at, u.valToPos(trace.y[k] + half, "y", true));
        pen.stroke();
        if (trace.symbol % 2) pen.fillRect(at - r, y - r, 2 * r, 2 * r);
        else {
          pen.beginPath();
          pen.arc(at, y, r, 0, 2 * Math.PI);
          pen.fill();
        }
      });
      pen.restore();
      return null;
    };
  }

  /** Marked stretches, the band of noise and the line of zero, behind the lines. */
  P.behind = (marks, noise) => (u) => {
    const pen = u.ctx;
    const { left, top, width, height } = u.bbox;
    pen.save();
    pen.beginPath();
    pen.rect(left, top, width, height);
    pen.clip();
    if (noise) {
      const [a, b] = [u.valToPos(noise, "y", true), u.valToPos(-noise, "y", true)];
      pen.globalAlpha = 0.16;
      pen.fillStyle = P.tint("soft");
      pen.fillRect(left, a, width, b - a);
    }
    marks.forEach(([from, to, label]) => {
      const [a, b] = [u.valToPos(from, "x", true), u.valToPos(to, "x", true)];
      pen.globalAlpha = 0.2;
      pen.fillStyle = P.tint("mark");
      pen.fillRect(a, top, Math.max(b - a, 1), height);
      pen.globalAlpha = 1;
      pen.fillStyle = P.tint("soft");
      pen.font = `${11 * devicePixelRatio}px ${P.tint("text")}`;
      pen.textAlign = "center";
      pen.fillText(label, (a + b) / 2, top + 11 * devicePixelRatio);
    });
    pen.globalAlpha = 1;
    pen.strokeStyle = P.tint("line");
    const zero = Math.round(u.valToPos(0, "y", true)) + 0.5;
    pen.beginPath();
    pen.moveTo(left, zero);
    pen.lineTo(left + width, zero);
    pen.stroke();
    pen.restore();
  };

  /** Plots of one group of charts over time: a dragged stretch is shown by all of them. */
  const groups = new Map();
  const zoom = (group, from, to) => group.forEach((u) => u.setScale("x", { min: from, max: to }));

  function draw(chart) {
    const at = document.getElementById(chart.id);
    // A line without places of its own has those of the line before it.
    let last = [];
    const traces = chart.traces.map((t) => ({ ...t, x: (last = t.x ? list(P.array(t.x)) : last), y: list(P.array(t.y)) }));
    const timed = chart.x_title === "time, s";
    const dots = traces.some((t) => t.mode !== "lines");
    const unit = chart.y_title;
    const data = traces.length > 1 ? uPlot.join(traces.map((t) => [t.x, t.y])) : [traces[0].x, traces[0].y];
    const key = at.closest("section, details, main")?.id + chart.id.replace(/-\d+$/, "");
    const group = groups.get(key) ?? groups.set(key, []).get(key);
    const plot = new uPlot({
      width: Math.max(at.clientWidth, 160), height: at.clientHeight, legend: { show: false },
      cursor: { sync: timed ? { key, setSeries: false } : undefined, y: false, drag: { x: true, y: false, setScale: false },
        bind: { dblclick: (u) => () => zoom(timed ? group : [u], data[0][0], data[0][data[0].length - 1]) } },
      scales: { x: { time: false, range: dots ? (u, a, b) => [a - 0.04 * (b - a), b + 0.04 * (b - a)] : (u, a, b) => [a, b] } },
      axes: P.axes(timed ? "" : chart.x_title, ""),
      series: [{}, ...traces.map((t, s) => ({
        label: t.name, stroke: () => P.tint(t.role), width: t.width, spanGaps: false, points: { show: false },
        paths: dots ? points(chart, traces) : undefined,
      }))],
      hooks: {
        drawAxes: [P.behind(chart.marks, chart.noise)],
        setSelect: [(u) => {
          if (u.select.width > 4) zoom(timed ? group : [u], u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"));
          u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
        }],
      },
    }, data, at);
    group.push(plot);
    plot.root.setAttribute("aria-hidden", "true");
    P.onTheme(() => plot.redraw(false));
    new ResizeObserver(() => at.clientWidth && plot.setSize({ width: at.clientWidth, height: at.clientHeight })).observe(at);
    const rows = () => {
      const head = [chart.x_title, ...traces.map((t) => t.name + (unit ? ", " + unit : ""))];
      return [head, ...P.every(data[0].length).map((k) => data.map((c) => P.short(c[k] ?? NaN, 4)))];
    };
    at.after(P.twin(chart.title, rows));
  }

  (P.json("charts") ?? []).forEach((chart) => {
    const at = document.getElementById(chart.id);
    if (at) P.whenNear(at, () => draw(chart));
  });

  // A link into a folded section opens it.
  const open = (id) => document.getElementById(id)?.closest("details")?.setAttribute("open", "");
  document.querySelectorAll("nav a").forEach((a) => a.addEventListener("click", () => open(a.getAttribute("href").slice(1))));
  if (/^#[a-z-]+$/.test(location.hash)) open(location.hash.slice(1));
  document.querySelector(".tools")?.append(P.themeButton());
  addEventListener("beforeprint", () => document.querySelectorAll("details.fold").forEach((d) => d.setAttribute("open", "")));
})();

"use strict";
(() => {
  const charts = JSON.parse(document.getElementById("charts").textContent);
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const symbols = ["circle", "square", "diamond", "triangle-up", "cross", "x"];
  // Names come from logs and vehicle files; the library would read tags in them.
  const plain = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");

  function colors() {
    const style = getComputedStyle(document.documentElement);
    return (name) => style.getPropertyValue("--" + name).trim();
  }

  function trace(t, chart, color) {
    const hollow = t.dashed;
    const out = {
      type: "scatter", mode: t.mode, name: plain(t.name), x: t.x, y: t.y, connectgaps: false,
      line: { color: color(t.role), width: t.width, dash: hollow ? "dash" : "solid" },
      marker: { color: hollow ? color("paper") : color(t.role), size: 8, symbol: symbols[t.symbol % symbols.length],
        line: { color: color(t.role), width: 1.5 } },
      hovertemplate: "%{x:.4~g}: %{y:.4~g}" + (chart.y_title ? " " + plain(chart.y_title) : ""),
    };
    if (t.bars.length) {
      out.error_y = { type: "data", array: t.bars, color: color(t.role), thickness: 1.2, width: 3 };
    }
    return out;
  }

  function layout(chart, color, width) {
    const shapes = [], annotations = [];
    chart.marks.forEach(([from, to, label]) => {
      shapes.push({ type: "rect", xref: "x", yref: "paper", x0: from, x1: to, y0: 0, y1: 1, layer: "below",
        fillcolor: color("mark"), opacity: 0.22, line: { width: 0 } });
      annotations.push({ xref: "x", yref: "paper", x: 0.5 * (from + to), y: 1, yanchor: "bottom", text: plain(label),
        showarrow: false, font: { size: 12, color: color("soft") } });
    });
    if (chart.noise) {
      shapes.push({ type: "rect", xref: "paper", yref: "y", x0: 0, x1: 1, y0: -chart.noise, y1: chart.noise,
        layer: "below", fillcolor: color("soft"), opacity: 0.16, line: { width: 0 } });
    }
    const axis = { gridcolor: color("grid"), zerolinecolor: color("soft"), zerolinewidth: 1, linecolor: color("faint"),
      tickcolor: color("faint"), automargin: true, title: { standoff: 6, font: { size: 13 } } };
    const x = { ...axis, title: { ...axis.title, text: plain(chart.x_title) }, zeroline: false };
    // The unit of y stands in the caption.
    const y = { ...axis, nticks: 6 };
    return {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false, hovermode: "closest",
      font: { family: getComputedStyle(document.body).fontFamily, size: 13, color: color("soft") },
      margin: { l: 40, r: 8, t: chart.marks.length ? 22 : 8, b: 40 }, xaxis: x, yaxis: y, shapes, annotations,
      dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",
    };
  }

  function draw(chart) {
    const at = document.getElementById(chart.id);
    const color = colors();
    Plotly.react(at, chart.traces.map((t) => trace(t, chart, color)), layout(chart, color, at.clientWidth),
      { responsive: true, displaylogo: false, displayModeBar: false, doubleClick: "reset" });
  }

  const all = () => charts.forEach(draw);
  all();
  dark.addEventListener("change", all);
  let waiting = 0;
  addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(all, 200); });
})();

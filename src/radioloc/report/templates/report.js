"use strict";
(async () => {
  const unpacked = async (id) => {
    const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
  };
  const script = document.createElement("script");
  script.textContent = await unpacked("library");
  document.head.append(script);
  const charts = JSON.parse(await unpacked("charts"));
  if (!window.Plotly) return; // the images stay

  const dark = matchMedia("(prefers-color-scheme: dark)");
  const touch = matchMedia("(pointer: coarse)").matches; // where dragging scrolls the page
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const series = (k) => (k === "left out" ? colour("--bad") : colour(`--series-${k % 7}`));
  const config = {
    responsive: true, displaylogo: false, displayModeBar: touch || "hover",
    modeBarButtons: [["zoomIn2d", "zoomOut2d", "pan2d", "zoom2d", "resetScale2d", "toImage"]],
  };
  const axis = () => ({
    gridcolor: colour("--rule"), zerolinecolor: colour("--faint"), linecolor: colour("--faint"), automargin: true,
  });
  const home = charts[0].layout.xaxis.range;
  let shown = home;

  const look = (chart) => ({
    ...chart.layout,
    xaxis: { ...chart.layout.xaxis, ...axis(), range: shown },
    yaxis: { ...chart.layout.yaxis, ...axis() },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: colour("--ink"), family: getComputedStyle(document.body).fontFamily, size: 12 },
    hoverlabel: { bgcolor: colour("--shade"), font: { color: colour("--ink") }, namelength: -1 },
    legend: { orientation: "h", x: 0, yref: "container", y: 0, yanchor: "bottom" },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("--faint"), activecolor: colour("--link") },
    margin: { l: 60, r: 8, t: touch ? 34 : 8, b: chart.layout.showlegend ? 66 : 40 },
    hovermode: "closest", dragmode: touch ? false : "zoom",
  });
  const traces = (chart) => chart.data.map((trace) => ({
    ...trace,
    type: "scatter",
    marker: { ...trace.marker, color: series(trace.marker.color), line: { color: series(trace.marker.color), width: trace.marker.symbol ? 1.5 : 0 } },
    ...(trace.error_y && { error_y: { ...trace.error_y, color: series(trace.marker.color) + "66" } }),
  }));

  const plots = [...document.querySelectorAll(".plot")];
  const drawn = new Set();
  const everyone = (range) => {
    shown = range;
    for (const plot of drawn) Plotly.relayout(plot, { "xaxis.range": [...range] });
  };
  const follow = (plot) => (change) => {
    const range = change["xaxis.range"] || [change["xaxis.range[0]"], change["xaxis.range[1]"]];
    const next = change["xaxis.autorange"] ? home : range[1] === undefined ? null : range.map((t) => +toDate(t));
    if (!next || next.every((t, k) => Math.abs(t - shown[k]) < 1)) return;
    shown = next;
    for (const other of drawn) if (other !== plot) Plotly.relayout(other, { "xaxis.range": [...next] });
  };
  // plotly writes dates as text without a zone, and means UTC.
  const toDate = (t) => (typeof t === "number" ? t : Date.parse(t.replace(" ", "T") + (t.includes(":") ? "Z" : "")));
  const keys = {
    "+": [0.25, -0.25], "=": [0.25, -0.25], "-": [-0.5, 0.5], ArrowLeft: [-0.25, -0.25], ArrowRight: [0.25, 0.25],
  };
  const onKey = (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "0") everyone(home);
    else if (keys[event.key]) {
      const width = shown[1] - shown[0];
      everyone(shown.map((t, k) => t + width * keys[event.key][k]));
    } else return;
    event.preventDefault();
  };

  document.documentElement.classList.add("drawn");
  const watch = new IntersectionObserver((entries) => {
    for (const { isIntersecting, target } of entries) {
      if (!isIntersecting || drawn.has(target)) continue;
      const chart = charts[plots.indexOf(target)];
      drawn.add(target);
      Plotly.newPlot(target, traces(chart), look(chart), config).then(() => {
        target.on("plotly_relayout", follow(target));
        target.addEventListener("keydown", onKey);
      });
    }
  }, { rootMargin: "600px" });
  for (const plot of plots) watch.observe(plot);
  dark.addEventListener("change", () => {
    for (const plot of drawn) {
      const chart = charts[plots.indexOf(plot)];
      Plotly.react(plot, traces(chart), look(chart), config);
    }
  });
})();

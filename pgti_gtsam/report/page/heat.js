// The heat view: three plots and the findings.

const heat = JSON.parse(byId("document").textContent);

const finite = (values) => values.map((value) => (Number.isFinite(value) ? value : null));

function draw(id, traces, axes, more = {}) {
  const layout = { ...plainLayout(), ...axes, ...more };
  return Plotly.react(id, traces, layout, plotConfig);
}

function drawEnergy() {
  const { times, energies } = heat.flow;
  return draw("energy", [{ x: times, y: energies, mode: "lines", line: { color: theme().blue, width: 2 } }],
    { xaxis: flatAxis("time, 1/H", { type: "log" }), yaxis: flatAxis("½‖e + Jδ‖²", { type: "log" }) });
}

function drawLeft() {
  const { keyframes, scalar, block } = heat.proxy;
  const top = [...scalar, ...block].reduce((most, value) => Math.max(most, value), 0);
  const colors = theme();
  const traces = [
    { x: [0, top], y: [0, top], mode: "lines", hoverinfo: "skip", line: { color: colors.muted, width: 1, dash: "dash" } },
    {
      x: scalar, y: block, text: keyframes.map(plotText), mode: "markers", marker: { size: 5, color: colors.blue },
      hovertemplate: "%{text}<br>scalar %{x:.3g}, H %{y:.3g}<extra></extra>",
    },
  ];
  return draw("left", traces,
    { xaxis: flatAxis("by the scalar Laplacian"), yaxis: flatAxis("by H") });
}

function drawArrival() {
  const colors = theme();
  const styles = { body: colors.blue, spatial: colors.red, scalar: colors.muted };
  const names = { body: "GTSAM’s frame", spatial: "spatial frame", scalar: "scalar Laplacian" };
  const traces = Object.entries(heat.spreading).map(([frame, { hops, arrivals }]) => ({
    x: finite(hops), y: finite(arrivals), name: names[frame], mode: "lines+markers",
    line: { color: styles[frame], width: 1.5 }, marker: { size: 4 },
  }));
  return draw("arrival", traces,
    { xaxis: flatAxis("hops", { type: "log" }), yaxis: flatAxis("time", { type: "log" }) },
    { showlegend: true, legend: topLegend, margin: { ...plainLayout().margin, t: 30 } });
}

const drawAll = () => Promise.all([drawEnergy(), drawLeft(), drawArrival()]);

fillHead(heat, "the heat view");
byId("verdict-level").textContent = short(heat.proxy_rank_correlation);
byId("verdict-text").textContent = "rank correlation of heat left, scalar Laplacian against H";
byId("findings").replaceChildren(
  table({ columns: ["finding", "", "meaning"], heads: 1, rows: heat.findings }));
byId("notes").replaceChildren(...notesOf(heat.input));
await drawAll();
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
document.body.dataset.ready = "true";

// What all plots share.

const plotConfig = {
  responsive: true, displaylogo: false, displayModeBar: false, doubleClick: "reset",
};
const mapConfig = {
  ...plotConfig, displayModeBar: window.innerWidth > 600, scrollZoom: true,
  modeBarButtonsToRemove: ["resetCameraDefault3d", "resetCameraLastSave3d"],
};

/** The page's colours, as the style sheet sets them for light or dark. */
function theme() {
  const style = getComputedStyle(document.documentElement);
  const names = [
    "ink", "muted", "grid", "panel", "blue", "red", "shade", "wash", "ball", "outline", "accent", "link", "fusion", "dull",
  ];
  return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

function plainLayout() {
  const colors = theme();
  return {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false, hovermode: "closest",
    font: { family: "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif", size: 12, color: colors.ink },
    hoverlabel: { bgcolor: colors.panel, bordercolor: colors.muted, font: { color: colors.ink }, align: "left" },
    margin: { l: 58, r: 12, t: 8, b: 44 },
    modebar: { bgcolor: colors.panel, color: colors.muted, activecolor: colors.ink },
  };
}

function flatAxis(title, more = {}) {
  const colors = theme();
  return {
    title: { text: title, standoff: 6, font: { color: colors.muted } }, gridcolor: colors.grid, zeroline: false,
    linecolor: colors.muted, tickfont: { color: colors.muted }, automargin: true,
    exponentformat: "power", ...more,
  };
}

const topLegend = { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", bgcolor: "rgba(0,0,0,0)" };

/** A dashed vertical line at x, in data units, over the whole height. */
const upright = (x) => ({
  type: "line", x0: x, x1: x, yref: "paper", y0: 0, y1: 1, line: { color: theme().muted, width: 1, dash: "dash" },
});

const decades = (values) => Math.log10(values.at(-1) / values[0]);

const cornerNote = (x, xanchor, text) => ({
  x, xanchor, yref: "paper", y: 1, yanchor: "top", showarrow: false, text, font: { color: theme().muted, size: 11 },
});

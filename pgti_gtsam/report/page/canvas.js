// A canvas above the map, to mark what is chosen. Each page has its own `drawMarks`.
// plotly uploads all traces of a scene when one changes, which takes seconds for large maps; a canvas takes nothing.

const context = byId("marks").getContext("2d");

/** A function from a position to where the map shows it, in pixels, with the pixels that a metre takes there. */
function projector() {
  // In plotly, which draws its own notes this way; it has no public name for these matrices.
  const { view, projection } = byId("map")._fullLayout.scene._scene.glplot.cameraParams;
  const { clientWidth: width, clientHeight: height } = byId("marks");
  const apply = (matrix, v) => [0, 1, 2, 3].map((row) => v.reduce((sum, c, k) => sum + matrix[4 * k + row] * c, 0));
  return (position) => {
    const [x, y, , depth] = apply(projection, apply(view, [...inBox(position), 1]));
    if (depth < 0.01) return null; // behind the eye
    const metre = (projection[5] * height) / (2 * depth * frame.scale);
    return { x: ((1 + x / depth) * width) / 2, y: ((1 - y / depth) * height) / 2, metre };
  };
}

/** Lay the canvas over the part of the plot that shows the scene. */
function fitCanvas({ l, t, w, h }) {
  const canvas = byId("marks");
  const ratio = window.devicePixelRatio;
  Object.assign(canvas.style, { left: `${l}px`, top: `${t}px`, width: `${w}px`, height: `${h}px` });
  Object.assign(canvas, { width: Math.round(w * ratio), height: Math.round(h * ratio) });
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
}

/** Draw the marks anew whenever plotly has moved its camera or changed its size: it tells of neither in time. */
function followCamera() {
  let drawn = "";
  const follow = () => {
    const { _size: size, scene } = byId("map")._fullLayout;
    const seen = [...scene._scene.glplot.cameraParams.view, size.l, size.t, size.w, size.h, devicePixelRatio].join();
    if (seen !== drawn) drawMarks();
    drawn = seen;
    requestAnimationFrame(follow);
  };
  follow();
}

/** Draw a path, a function that adds to the context, above a rim that sets it off from whatever lies below. */
function stroke(path, color, width, { dash = [], rim = null } = {}) {
  Object.assign(context, { lineCap: "round", lineJoin: "round" });
  context.beginPath();
  path();
  context.setLineDash(dash);
  for (const [style, size] of [...(rim ? [[rim, width + 3]] : []), [color, width]]) {
    Object.assign(context, { strokeStyle: style, lineWidth: size });
    context.stroke();
  }
  context.setLineDash([]);
}

const disc = ({ x, y }, radius) => () => context.arc(x, y, radius, 0, 2 * Math.PI);

function line(points) {
  return () => points.forEach((p, k) => (k ? context.lineTo(p.x, p.y) : context.moveTo(p.x, p.y)));
}

/** A ring with its label on a flag above, or below. */
function drawRing({ x, y }, colors, label, below = false, radius = 9) {
  stroke(disc({ x, y }, radius), colors.ink, 3, { rim: colors.panel });
  const text = label.length > 40 ? `${label.slice(0, 39)}…` : label;
  context.font = "12px system-ui, sans-serif";
  const width = context.measureText(text).width + 10;
  const toFlag = below ? 1 : -1;
  const middle = y + toFlag * (radius + 20);
  stroke(line([{ x, y: y + toFlag * (radius + 1) }, { x, y: middle }]), colors.ink, 1.5);
  context.fillStyle = colors.ink;
  context.fillRect(x - width / 2, middle - 9.5, width, 19);
  Object.assign(context, { fillStyle: colors.panel, textAlign: "center", textBaseline: "middle" });
  context.fillText(text, x, middle + 0.5);
}

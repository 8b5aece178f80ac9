// What is chosen, on a canvas above the map: the keyframe's ring, its spheres, the place's stretches, the closure.
// plotly uploads all traces of a scene when one changes, which takes seconds for large maps; a canvas takes nothing.

// Apart from one another, from the edges' colours, and from a light and a dark ground.
const placeColours = ["#d9780a", "#12a08a", "#a05bd6", "#d6559f", "#8a9a1c", "#2aa3d9", "#a0693a", "#5f74d8"];
const placeColour = (k) => placeColours[k % placeColours.length];

const mostNeighbours = 300; // spheres drawn around the chosen one
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

function drawMarks() {
  fitCanvas(byId("map")._fullLayout._size);
  const colors = theme();
  const project = projector();
  const at = (keyframe) => project(keyframes.position[keyframe]);
  const spheres = byId("show-spheres").checked ? drawSpheres(at, colors) : 0;
  if (state.place !== null) drawPlace(at, colors, state.place);
  const other = state.closure === null ? null : drawClosure(at, colors, closures[state.closure]);
  const chosen = at(state.keyframe);
  if (chosen !== null) drawRing(chosen, colors, keyframes.label[state.keyframe], other !== null && other.y < chosen.y);
  byId("marks").setAttribute("aria-label", marksInWords(spheres));
}

function marksInWords(spheres) {
  return [
    `Marked: keyframe ${keyframes.label[state.keyframe]}`,
    ...(state.place === null ? [] : [`place ${places[state.place].rank}`]),
    ...(state.closure === null ? [] : [`closure ${closureLabel(closures[state.closure])}`]),
    plural(spheres, "sphere"),
  ].join(", ");
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

/** The spheres of the chosen keyframe and of those that it overlaps; returns how many. */
function drawSpheres(at, colors) {
  const overlapped = overlapsOf(state.keyframe).slice(0, mostNeighbours);
  const drawn = keyframes.radius[state.keyframe] > 0 ? [...overlapped, state.keyframe] : [];
  for (const i of drawn) {
    const centre = at(i);
    if (centre === null) continue;
    const chosen = i === state.keyframe;
    context.globalAlpha = chosen ? 0.3 : Math.max(0.02, 0.12 / (1 + overlapped.length / 20));
    context.fillStyle = colors.ball;
    context.beginPath();
    disc(centre, keyframes.radius[i] * centre.metre)();
    context.fill();
    context.globalAlpha = chosen ? 1 : 0.45;
    stroke(disc(centre, keyframes.radius[i] * centre.metre), colors.ball, chosen ? 2 : 1);
  }
  context.globalAlpha = 1;
  return drawn.length;
}

/** Both stretches, the later one dashed, and a thin line between the two keyframes that are closest. */
function drawPlace(at, colors, k) {
  places[k].stretches.forEach((ends, pass) => {
    const points = stretch(ends).map(at).filter((p) => p !== null);
    context.globalAlpha = 0.8;
    if (points.length === 1) stroke(disc(points[0], 6), placeColour(k), 4);
    else stroke(line(points), placeColour(k), 6, { dash: pass ? [9, 10] : [] });
  });
  context.globalAlpha = 1;
  const tie = places[k].closest.map(at);
  if (!tie.includes(null)) stroke(line(tie), colors.ink, 2, { rim: colors.panel });
}

/** A line and the end that is not chosen; returns where that is, or null. The flags point away from the line. */
function drawClosure(at, colors, closure) {
  const other = closure.keyframes.find((i) => i !== state.keyframe);
  const [end, chosen] = [other, state.keyframe].map((i) => (i === undefined ? null : at(i)));
  if (end === null || chosen === null) return null;
  stroke(line([end, chosen]), closure.is_false ? colors.red : colors.link, 3, { rim: colors.panel });
  drawRing(end, colors, keyframes.label[other], end.y >= chosen.y, 5);
  return end;
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

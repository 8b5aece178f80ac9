// What is chosen, on the canvas: the keyframe's ring, its spheres, the place's stretches, the closure.

// Apart from one another, from the edges' colours, and from a light and a dark ground.
const placeColours = ["#d9780a", "#12a08a", "#a05bd6", "#d6559f", "#8a9a1c", "#2aa3d9", "#a0693a", "#5f74d8"];
const placeColour = (k) => placeColours[k % placeColours.length];

const mostNeighbours = 300; // spheres drawn around the chosen one
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

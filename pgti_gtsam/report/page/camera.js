// Where the map is looked at from. plotly measures eyes in units of the plotted box, `frame.scale` metres long at most.

const fieldOfView = Math.PI / 4; // of plotly's perspective camera, vertically
const nearest = 0.05; // of the box: nearer than this, plotly's clipping plane cuts the map
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((v) => v / Math.hypot(...a));
const xyz = ([x, y, z]) => ({ x, y, z });

/** The box that holds all positions, spheres included, and its scale in metres. */
const frame = (() => {
  const axes = [keyframes.x, keyframes.y, keyframes.z];
  const extremes = axes.map((values) => [
    values.reduce((low, v) => Math.min(low, v), Infinity),
    values.reduce((high, v) => Math.max(high, v), -Infinity),
  ]);
  const lengths = extremes.map(([low, high]) => high - low);
  const reach = keyframes.radius.reduce((most, r) => (Number.isFinite(r) && r > most ? r : most), 0);
  const margin = Math.max(0.05 * Math.max(...lengths), reach, 0.5);
  const margins = [margin, margin, planar ? 0.01 * margin : margin];
  const range = extremes.map(([low, high], k) => [low - margins[k], high + margins[k]]);
  const centre = range.map(([low, high]) => (low + high) / 2);
  const scale = Math.max(...range.map(([low, high]) => high - low));
  const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((bits) => range.map((ends, k) => ends[(bits >> k) & 1]));
  return { lengths, range, corners, centre, scale, ratio: range.map(([low, high]) => (high - low) / scale) };
})();

const inBox = (position) => position.map((v, k) => (v - frame.centre[k]) / frame.scale);

/**
 * Direction to the eye and up vector. A planar map is seen from straight above. In space the z axis points up, unless
 * the map is far flatter along y: then its poses are a camera's, whose y axis points down. The longer side lies across.
 */
const viewpoint = (() => {
  if (planar) return { toEye: [0, 0, 1], up: [0, 1, 0] };
  const [x, y, z] = frame.lengths;
  if (y < 0.5 * Math.min(x, z)) return { toEye: unit(x > z ? [0.3, -1, -0.8] : [0.8, -1, 0.3]), up: [0, -1, 0] };
  return { toEye: unit(x > y ? [0.3, -0.8, 1] : [0.8, -0.3, 1]), up: [0, 0, 1] };
})();

/** The camera that sees these positions in the middle and as large as the plot's width / height allows. */
function cameraOn(positions, aspect) {
  const { toEye, up } = viewpoint;
  const right = unit(cross(up, toEye));
  const above = cross(toEye, right);
  const slope = 0.86 * Math.tan(fieldOfView / 2); // the rest is for the axes' titles
  const points = positions.map(inBox).map((p) => [dot(p, right), dot(p, above), dot(p, toEye)]);
  let [x, y] = [0, 1].map((k) => middleOf(points.map((p) => p[k])));
  const z = middleOf(points.map((p) => p[2]));
  let distance = 0;
  for (let round = 0; round < 8; round++) { // what is near looks larger: the middle of the picture follows the distance
    const needed = (p) => p[2] - z + Math.max(Math.abs(p[1] - y), Math.abs(p[0] - x) / aspect) / slope;
    distance = points.reduce((most, p) => Math.max(most, needed(p)), nearest);
    x += distance * middleOf(points.map((p) => (p[0] - x) / (distance - (p[2] - z))));
    y += distance * middleOf(points.map((p) => (p[1] - y) / (distance - (p[2] - z))));
  }
  const middle = [0, 1, 2].map((k) => x * right[k] + y * above[k] + z * toEye[k]);
  return { center: xyz(middle), eye: xyz(middle.map((v, k) => v + distance * toEye[k])), up: xyz(up) };
}

const middleOf = (values) => (values.reduce((a, b) => Math.min(a, b)) + values.reduce((a, b) => Math.max(a, b))) / 2;

/** The distance from the eye to what it looks at. */
const eyeDistance = ({ eye, center }) => Math.hypot(eye.x - center.x, eye.y - center.y, eye.z - center.z);

/** Corners of the cube around a position, to look at a neighbourhood. */
function around(position, reach) {
  const signs = [-1, 1];
  return signs.flatMap((a) => signs.flatMap((b) => signs.map((c) => [a, b, c].map((s, k) => position[k] + s * reach))));
}

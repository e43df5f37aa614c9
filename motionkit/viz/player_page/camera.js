// The view that all panels share, and what turns, moves and zooms it.

const FIRST_VIEW = { yaw: -0.6, pitch: 0.2, zoom: 1, right: 0, up: 0 };
const LOWEST_PITCH = -0.3, HIGHEST_PITCH = 1.55, NEAREST_ZOOM = 40, FARTHEST_ZOOM = 0.05;
const view = { ...FIRST_VIEW };

// A function from points in metres to places on a canvas (x, y, how near), for a body of `size` metres around `centre`.
function projection(width, height, centre, size, yaw) {
  const scale = Math.min(0.8 * height, 0.88 * width) / size * view.zoom, eye = 6 * size / Math.min(1, view.zoom);
  const cy = Math.cos(yaw), sy = Math.sin(yaw), cp = Math.cos(view.pitch), sp = Math.sin(view.pitch);
  const x0 = width / 2 + view.right * scale * size, y0 = height / 2 - view.up * scale * size;
  const project = (x, y, z) => {
    x -= centre[0]; y -= centre[1]; z -= centre[2];
    const side = cy * x - sy * z, depth = sy * x + cy * z;
    const near = eye / Math.max(0.05 * eye, eye - (sp * y + cp * depth));
    return [x0 + scale * near * side, y0 - scale * near * (cp * y - sp * depth), near];
  };
  project.scale = scale;
  return project;
}

function zoomBy(factor) { view.zoom = Math.max(FARTHEST_ZOOM, Math.min(NEAREST_ZOOM, view.zoom * factor)); }

// One pointer turns (with Shift or another button it moves), two move and zoom.
function controlView(canvas, changed) {
  const pointers = new Map();
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, distance: Math.max(1, Math.hypot(a.x - b.x, a.y - b.y)) };
  };
  const move = (dx, dy) => {
    const unit = Math.min(0.8 * canvas.clientHeight, 0.88 * canvas.clientWidth) * view.zoom;
    view.right += dx / unit; view.up -= dy / unit;
  };
  canvas.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = pointers.get(event.pointerId);
    if (!last) return;
    const here = { x: event.clientX, y: event.clientY };
    if (pointers.size === 2) {
      const before = spread();
      pointers.set(event.pointerId, here);
      const after = spread();
      move(after.x - before.x, after.y - before.y);
      zoomBy(after.distance / before.distance);
    } else {
      pointers.set(event.pointerId, here);
      const dx = here.x - last.x, dy = here.y - last.y;
      if (event.shiftKey || event.buttons > 1) move(dx, dy);
      else {
        view.yaw -= dx * 0.01;
        view.pitch = Math.max(LOWEST_PITCH, Math.min(HIGHEST_PITCH, view.pitch + dy * 0.01));
      }
    }
    changed();
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
    canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoomBy(Math.exp(-event.deltaY * 0.001)); changed(); }, { passive: false });
  canvas.addEventListener("dblclick", () => { Object.assign(view, FIRST_VIEW); changed(); });
}

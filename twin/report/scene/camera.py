"""The camera of our pages, as script: as near as it can be with all that matters inside the picture."""

from __future__ import annotations

from typing import Final

CAMERA: Final = """
  // The world of three.js is y up: base (x, y, z) is (x, z, -y) there.
  const vector = (x, y, z) => viewer.camera.position.clone().set(x, y, z);
  const world = p => vector(p[0], p[2], -p[1]);
  const FOV = 26, TANGENT = Math.tan(FOV * Math.PI / 360);
  // As near as it can be with all points inside tangents (tx, ty) of the middle of the picture.
  function fit(camera, controls, points, direction, tx, ty) {
    const seen = points.map(world), back = world(direction).normalize();
    const right = vector(0, 1, 0).cross(back).normalize(), up = back.clone().cross(right), centre = vector(0, 0, 0);
    seen.forEach(p => centre.addScaledVector(p, 1 / seen.length));
    // A single point still needs a distance.
    let distance = 1e-3;
    for (let round = 0; round < 8; round++) {
      const local = seen.map(p => p.clone().sub(centre)).map(p => ({ x: p.dot(right), y: p.dot(up), z: p.dot(back) }));
      distance = Math.max(1e-3, ...local.map(p => p.z + Math.max(Math.abs(p.x) / tx, Math.abs(p.y) / ty)));
      const middle = key => { const s = local.map(p => p[key] / (distance - p.z)); return (Math.max(...s) + Math.min(...s)) / 2; };
      centre.addScaledVector(right, 0.7 * distance * middle("x")).addScaledVector(up, 0.7 * distance * middle("y"));
    }
    camera.fov = FOV; camera.near = distance / 200; camera.far = distance * 40; camera.zoom = 1;
    camera.position.copy(centre).addScaledVector(back, distance);
    controls.target.copy(centre);
    controls.update();
  }
"""
"""For a script that has ``viewer``: ``vector``, ``world``, ``FOV``, ``TANGENT``, ``fit``. No dollar sign: it goes into templates."""

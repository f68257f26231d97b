"""The page around a scene: layout, legend, the close-up of the path, and the controls. No external resources."""

from __future__ import annotations

from string import Template

_STYLE = """
html, body { margin: 0; height: 100%; overflow: hidden; background: linear-gradient(#ffffff, #e4e9ee);
  font: 14px/1.4 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; color: #20242a; }
#meshcat-pane { position: fixed; inset: 0; z-index: 1; }
#meshcat-pane canvas { display: block; }
.dg { display: none; }
#title, #panel, #bar, #callout, #triad { position: fixed; z-index: 2; }
#title { left: 20px; top: 14px; pointer-events: none; }
#title h1 { margin: 0; font-size: 21px; font-weight: 650; letter-spacing: -.01em; }
#title p { margin: 1px 0 0; color: #59616b; }
#slider { flex: 1; min-width: 60px; accent-color: #21918c; }
#panel { right: 16px; top: 16px; bottom: 84px; display: flex; flex-direction: column; pointer-events: none; }
#panel header { padding: 9px 14px 7px; background: #ffffff; border: 1px solid #c3cad2; border-radius: 8px 8px 0 0; }
#panel h2 { margin: 0; font-size: 15px; font-weight: 650; }
#panel header p { margin: 0; color: #59616b; font-size: 12.5px; }
#closeup { flex: 1; min-height: 120px; border: 1px solid #c3cad2; border-width: 0 1px;
  pointer-events: auto; cursor: grab; touch-action: none; }
#paper { position: fixed; z-index: 0; background: #ffffff; }
#legend { padding: 10px 14px 11px; background: #ffffff; border: 1px solid #c3cad2; border-radius: 0 0 8px 8px; }
#colours { height: 13px; border-radius: 3px; background: linear-gradient(to right, $gradient); }
#ticks { display: flex; justify-content: space-between; font-size: 12.5px; font-variant-numeric: tabular-nums; margin-top: 2px; }
#figures { display: flex; flex-wrap: wrap; gap: 2px 26px; margin: 7px 0 0; }
#figures div { white-space: nowrap; }
#figures b { font-size: 17px; font-weight: 650; font-variant-numeric: tabular-nums; }
#figures span { color: #59616b; font-size: 12.5px; }
#key { margin: 6px 0 0; font-size: 12.5px; color: #444b54; display: flex; flex-wrap: wrap; gap: 0 16px; }
#key i { display: inline-block; width: 20px; height: 0; border-top: 2px solid; vertical-align: 4px; margin-right: 5px; }
.notice { margin: 8px 0 0; padding: 5px 9px; background: #fff1cf; border: 1px solid #d9a321; border-radius: 5px;
  font-weight: 650; font-size: 13px; }
#callout { display: none; padding: 1px 7px; background: #ffffffee; border: 1px solid #d61a1f; border-radius: 4px; color: #a01014;
  font-size: 12.5px; font-weight: 600; white-space: nowrap; pointer-events: none; }
#bar { left: 16px; right: 16px; bottom: 14px; min-height: 34px; padding: 8px 12px; display: flex; align-items: center; gap: 14px;
  background: #ffffff; border: 1px solid #c3cad2; border-radius: 8px; }
#bar button { font: inherit; font-weight: 600; min-width: 84px; flex: none; padding: 5px 10px; border: 1px solid #97a1ad;
  border-radius: 6px; background: #f2f5f8; cursor: pointer; white-space: nowrap; }
#bar button:hover { background: #e3e9ef; }
#now { font-variant-numeric: tabular-nums; font-size: 13px; display: flex; gap: 12px; white-space: nowrap; }
#now span { display: inline-block; text-align: right; }
#now em { font-style: normal; color: #59616b; }
#hint { color: #59616b; font-size: 12px; white-space: nowrap; }
.still #play, .still #slider { display: none; }
#triad { left: 16px; bottom: 84px; width: 92px; height: 92px; pointer-events: none; }
#triad text { font-size: 12px; font-weight: 650; text-anchor: middle; dominant-baseline: central; }
@media (max-width: 1450px) { #hint { display: none; } }
@media (max-width: 1250px) { #now { gap: 9px; font-size: 12px; } #title h1 { font-size: 17px; } }
@media (max-width: 900px) { #bar { gap: 8px; padding: 8px; } #bar button { min-width: 0; padding: 5px 8px; }
  #now { gap: 2px; font-size: 11px; } }
"""

_SCRIPT = """
"use strict";
(function () {
  const page = $page;
  const element = id => document.getElementById(id);
  const viewer = new MeshCat.Viewer(element("meshcat-pane"));
  window.viewer = viewer;
  viewer.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
  for (const command of $commands) {
    viewer.handle_command_bytearray(Uint8Array.from(atob(command), c => c.charCodeAt(0)));
  }
  const node = name => viewer.scene_tree.find(["meshcat"].concat(name.split("/")));
  const object = name => node(name).object;
  viewer.scene.updateMatrixWorld(true);

  // Layer 0: the machine and the bold path. Layer 1: the close-up of the path; light falls on both.
  const closeOnly = [page.work + "/fine", page.work + "/nominal", page.work + "/arrows", page.tool + "/ghost", page.tool + "/tip"];
  for (const name of closeOnly) object(name).traverse(o => o.layers.set(1));
  object(page.work + "/rapids").traverse(o => o.layers.enable(1));
  object(page.work).traverse(o => { if (o.parent.name.startsWith("pale")) o.layers.set(1); });
  viewer.scene.traverse(o => { if (o.isLight) o.layers.enable(1); });

  // Cameras.
  const main = viewer.camera;
  const Controls = viewer.controls.constructor;
  const close = main.clone();
  const eye = main.clone();
  eye.matrixAutoUpdate = false;
  eye.layers.set(1);
  const closeControls = new Controls(close, element("closeup"));
  closeControls.screenSpacePanning = true;
  closeControls.addEventListener("change", () => viewer.set_dirty());
  const upright = viewer.scene.matrix.clone();
  const fromUpright = upright.clone(); (fromUpright.invert ? fromUpright.invert() : fromUpright.getInverse(upright));
$camera
  let touched = false, touchedClose = false;
  viewer.controls.addEventListener("start", () => { touched = true; });
  closeControls.addEventListener("start", () => { touchedClose = true; });
  function rectangle() {
    const r = element("closeup").getBoundingClientRect();
    return { x: r.left + 1, y: r.top, w: r.width - 2, h: r.height };
  }
  function layout() {
    const w = window.innerWidth, h = window.innerHeight;
    element("panel").style.width = Math.round(Math.max(330, Math.min(0.42 * w, 700))) + "px";
    const r = rectangle(), paper = element("paper").style;
    paper.left = r.x + "px"; paper.top = r.y + "px"; paper.width = r.w + "px"; paper.height = r.h + "px";
    viewer.set_3d_pane_size(w, h);
    // The machine stands in the middle of what title, panel and bar leave free: the picture is shifted by a part of the window.
    const left = 14, top = 56, freeW = r.x - 12 - left, freeH = h - 84 - top;
    main.setViewOffset(w, h, w / 2 - (left + freeW / 2), h / 2 - (top + freeH / 2), w, h);
    if (!touched) fit(main, viewer.controls, page.outline, [-0.62, -1.3, 0.62], TANGENT * freeW / h, TANGENT * freeH / h);
    if (!touchedClose) fit(close, closeControls, page.pathOutline, [-0.5, -1.2, 0.85], 0.88 * TANGENT * r.w / r.h, 0.88 * TANGENT);
    viewer.set_dirty();
  }
  window.onload = layout;
  window.addEventListener("resize", layout);
  element("view").addEventListener("click", () => { touched = touchedClose = false; layout(); });

  // A second picture in the same frame: the path, seen from the workpiece, which therefore stands still.
  function drawCloseup() {
    const renderer = viewer.renderer, r = rectangle(), h = window.innerHeight;
    close.aspect = eye.aspect = r.w / r.h;
    eye.fov = close.fov; eye.near = close.near; eye.far = close.far; eye.zoom = close.zoom;
    eye.updateProjectionMatrix();
    close.updateMatrixWorld();
    eye.matrix.copy(object(page.work).matrixWorld).multiply(fromUpright).multiply(close.matrixWorld);
    eye.updateMatrixWorld(true);
    renderer.setScissorTest(true);
    renderer.setScissor(r.x, h - r.y - r.h, r.w, r.h);
    renderer.setViewport(r.x, h - r.y - r.h, r.w, r.h);
    renderer.render(viewer.scene, eye);
    renderer.setScissorTest(false);
    renderer.setViewport(0, 0, window.innerWidth, h);
    const at = object(page.work).localToWorld(vector(page.worst.at[0], page.worst.at[1], page.worst.at[2])).project(eye);
    const callout = element("callout");
    const inside = Math.abs(at.x) < 0.98 && Math.abs(at.y) < 0.98;
    callout.style.display = inside && page.worst.um !== "0" ? "block" : "none";
    const x = r.x + (at.x + 1) / 2 * r.w + 12, y = r.y + (1 - at.y) / 2 * r.h - 40;
    callout.style.left = Math.max(r.x + 4, Math.min(x, r.x + r.w - callout.offsetWidth - 4)) + "px";
    callout.style.top = Math.max(r.y + 4, y) + "px";
  }
  function drawTriad() {
    const letters = [["X", [1, 0, 0], "#c0281d"], ["Y", [0, 1, 0], "#1d7f3c"], ["Z", [0, 0, 1], "#1d4fb4"]];
    const tips = letters.map(([name, axis, colour]) => {
      const p = world(axis).transformDirection(main.matrixWorldInverse);
      return { name, colour, x: 46 + 30 * p.x, y: 46 - 30 * p.y, lx: 46 + 39 * p.x, ly: 46 - 39 * p.y, z: p.z };
    }).sort((a, b) => a.z - b.z);
    element("triad").innerHTML = tips.map(t => '<line x1="46" y1="46" x2="' + t.x + '" y2="' + t.y + '" stroke="' + t.colour
      + '" stroke-width="2.5"/><text x="' + t.lx + '" y="' + t.ly + '" fill="' + t.colour + '">' + t.name + "</text>").join("");
  }
  const draw = viewer.render.bind(viewer);
  viewer.render = function () {
    draw();
    drawCloseup();
    drawTriad();
    tell();
  };

  // Where it is, in words.
  const animator = viewer.animator, slider = element("slider"), play = element("play");
  const moves = page.share.length > 1;
  const cells = {};
  const cell = (key, width) => {
    const span = document.createElement("span");
    span.style.minWidth = width + "em";
    element("now").appendChild(span);
    cells[key] = span;
  };
  cell("line", 5); page.axes.forEach(axis => cell(axis.name, 5.6)); cell("um", 7);
  let last = -1;
  function tell() {
    const time = moves ? Math.max(0, Math.min(animator.time, page.seconds)) : 0;
    if (time === last) return;
    last = time;
    const share = time / page.seconds;
    let low = 0, high = page.share.length - 1;
    while (high - low > 1) { const mid = (low + high) >> 1; if (page.share[mid] <= share) low = mid; else high = mid; }
    const part = moves ? Math.max(0, Math.min(1, (share - page.share[low]) / (page.share[high] - page.share[low]))) : 0;
    const between = (a, b) => a + part * (b - a);
    const block = part > 0 ? high : low;
    cells.line.innerHTML = "<em>line</em> " + page.line[block];
    page.axes.forEach((axis, i) => {
      const value = between(page.q[low][i], page.q[high][i]);
      const text = axis.unit === "mm" ? value.toFixed(2) : value.toFixed(1) + "°";
      cells[axis.name].innerHTML = "<em>" + axis.name + "</em> " + text;
    });
    cells.um.innerHTML = page.cutting[block] ? between(page.um[low], page.um[high]).toFixed(1) + " <em>µm</em>" : "<em>rapid</em>";
    slider.value = Math.round(1000 * share);
  }
  const label = () => { play.textContent = animator.playing ? "❚❚ Pause" : "▶ Play"; };
  function toggle() { if (animator.playing) animator.pause(); else { animator.play(); } label(); }
  function seek(time) {
    if (animator.playing) animator.pause();
    animator.seek(time);
    animator.display_progress(time);
    label();
    viewer.set_dirty();
  }
  if (moves) {
    play.addEventListener("click", toggle);
    slider.addEventListener("input", () => seek(page.seconds * slider.value / 1000));
    window.addEventListener("keydown", event => {
      if (event.code !== "Space" || event.target === play) return;
      event.preventDefault();
      toggle();
    });
    // page.html#t=12.5 opens at that second, paused.
    const wanted = /[#&]t=([0-9.]+)/.exec(location.hash);
    if (wanted) seek(Math.min(page.seconds, Number(wanted[1])));
  }
  label();
  layout();
})();
"""

PAGE = Template(
    """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; \
img-src data: blob:">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>$title</title>
<style>"""
    + _STYLE
    + """</style>
</head>
<body class="$still">
<div id="paper"></div>
<div id="meshcat-pane"></div>
<div id="title"><h1>$title</h1><p>$machine</p></div>
<section id="panel">
<header><h2>Tool path, deviation × $factor</h2><p>in the workpiece frame, seen from the workpiece</p></header>
<div id="closeup"></div>
<div id="legend">
<div id="colours"></div><div id="ticks">$ticks</div>
<div id="figures"><div><span>deviation in µm</span></div><div><span>max</span> <b>$max_um µm</b> <span>at line $max_line</span></div>
<div><span>RMS</span> <b>$rms_um µm</b> <span>over $what</span></div></div>
<div id="key"><span><i style="border-color:#6b737d"></i>nominal</span><span><i style="border-color:#b8c7db"></i>rapid</span>
<span><i style="border-color:#21242b"></i>deviation × $factor</span><span><i style="border-color:#d61a1f"></i>largest</span></div>
$notice
</div>
</section>
<div id="callout">max $max_um µm · line $max_line</div>
<svg id="triad"></svg>
<div id="bar"><button id="play">▶ Play</button><input id="slider" type="range" min="0" max="1000" value="0" aria-label="time">
<div id="now"></div><button id="view">Reset view</button>
<div id="hint">Space: play or pause · drag: turn · wheel: zoom · mm, degrees</div></div>
<script>$viewer</script>
<script>"""
    + _SCRIPT
    + """</script>
</body>
</html>
"""
)

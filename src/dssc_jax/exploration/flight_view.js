// A flight in three dimensions: everything is projected anew for the time of the slider and the direction of view.

function rotation(phi, theta, psi) {
  // R_z(psi) R_y(theta) R_x(phi), body to inertial, by rows.
  const [cf, sf, ct, st, cp, sp] = [phi, theta, psi].flatMap(angle => [Math.cos(angle), Math.sin(angle)])
  return [
    [ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp],
    [ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp],
    [-st, sf * ct, cf * ct],
  ]
}

function projection(scene) {
  // Parallel projection from the direction of azimuth and elevation; [x, y, z] to [across, upward].
  const ca = Math.cos(scene.azimuth[0]), sa = Math.sin(scene.azimuth[0])
  const ce = Math.cos(scene.elevation[0]), se = Math.sin(scene.elevation[0])
  const [cx, cy, cz] = [scene.cx[0], scene.cy[0], scene.cz[0]]
  return (x, y, z) => {
    const [dx, dy, dz] = [x - cx, y - cy, z - cz]
    return [-sa * dx + ca * dy, -se * ca * dx - se * sa * dy + ce * dz]
  }
}

function projected(project, xs, ys, zs, count) {
  const across = [], upward = []
  for (let i = 0; i < count; i++) {
    const [a, u] = project(xs[i], ys[i], zs[i])
    across.push(a)
    upward.push(u)
  }
  return {across, upward}
}

function sampleAt(times, t) {
  // The last sample at or before t.
  let row = 0
  while (row + 1 < times.length && times[row + 1] <= t + 1e-9) row++
  return row
}

function craftLines(project, flight, row, size) {
  // Arms of a cross, the front one longer, and the upward axis; drawn larger than life.
  const lines = {across: [], upward: [], colour: []}
  const R = rotation(flight.phi[row], flight.theta[row], flight.psi[row])
  const turned = v => R.map(line => line[0] * v[0] + line[1] * v[1] + line[2] * v[2])
  const place = [flight.x[row], flight.y[row], flight.z[row]]
  const parts = [
    [[-0.7, -0.7, 0], [0.7, 0.7, 0], "#333333"], [[-0.7, 0.7, 0], [0.7, -0.7, 0], "#333333"],
    [[0, 0, 0], [1.3, 0, 0], "#D55E00"], [[0, 0, 0], [0, 0, 0.9], "#009E73"],
  ]
  for (const [from, to, colour] of parts) {
    const ends = [from, to].map(v => turned(v).map((part, i) => place[i] + size * part))
    const [start, end] = ends.map(p => project(p[0], p[1], p[2]))
    lines.across.push([start[0], end[0]])
    lines.upward.push([start[1], end[1]])
    lines.colour.push(colour)
  }
  return lines
}

function draw(args) {
  const {scene, tracks, flight, floor, slider, layers} = args
  const view = scene.data, project = projection(view), all = tracks.data
  const row = sampleAt(flight.data.t, slider.value)
  const span = view.span[0]
  const ghosts = {across: [], upward: [], colour: []}
  const points = {across: [], upward: [], colour: []}
  const marks = {across: [], upward: []}
  for (let k = 0; k < all.x.length; k++) {
    const line = projected(project, all.x[k], all.y[k], all.z[k], all.x[k].length)
    ghosts.across.push(line.across)
    ghosts.upward.push(line.upward)
    ghosts.colour.push(all.colour[k])
    if (Number.isFinite(all.x[k][row])) {
      points.across.push(line.across[row])
      points.upward.push(line.upward[row])
      points.colour.push(all.colour[k])
    }
    const mark = all.mark[k]
    if (mark >= 0 && mark <= row) {
      marks.across.push(line.across[mark])
      marks.upward.push(line.upward[mark])
    }
  }
  const flown = projected(project, flight.data.x, flight.data.y, flight.data.z, row + 1)
  const wanted = projected(project, flight.data.x_ref, flight.data.y_ref, flight.data.z_ref, flight.data.t.length)
  const lines = {across: [], upward: []}
  for (let k = 0; k < floor.data.x.length; k++) {
    const line = projected(project, floor.data.x[k], floor.data.y[k], floor.data.z[k], 2)
    lines.across.push(line.across)
    lines.upward.push(line.upward)
  }
  layers.floor.data = lines
  layers.ghosts.data = ghosts
  layers.points.data = points
  layers.marks.data = marks
  layers.flown.data = flown
  layers.wanted.data = wanted
  layers.craft.data = craftLines(project, flight.data, row, 0.08 * span)
}

function turn(scene, dx, dy) {
  const azimuth = scene.data.azimuth[0] - 0.008 * dx
  const elevation = Math.min(1.57, Math.max(-0.2, scene.data.elevation[0] + 0.008 * dy))
  scene.data = {...scene.data, azimuth: [azimuth], elevation: [elevation]}
}

function magnify(ranges, delta) {
  const factor = delta > 0 ? 0.9 : 1 / 0.9
  for (const range of ranges) range.setv({start: range.start * factor, end: range.end * factor})
}

function play(button, slider) {
  // Ten seconds for the whole flight, then from the beginning again.
  if (button.timer) clearInterval(button.timer)
  if (!button.active) return
  button.timer = setInterval(() => {
    const next = slider.value + (slider.end - slider.start) / 200
    slider.value = next > slider.end ? slider.start : next
  }, 50)
}

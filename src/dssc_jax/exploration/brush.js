// What happens to a brushed set of draws: counts with the exact interval of Clopper and Pearson, histograms, a click.

function logGamma(x) {
  // Lanczos' approximation with g = 7, as in the Numerical Recipes of Press et al.
  const c = [0.99999999999980993, 676.5203681218851, -1259.1392167224028, 771.32342877765313, -176.61502916214059,
    12.507343278686905, -0.13857109526572012, 9.9843695780195716e-6, 1.5056327351493116e-7]
  let sum = c[0]
  for (let i = 1; i < 9; i++) sum += c[i] / (x - 1 + i)
  const t = x + 6.5
  return 0.5 * Math.log(2 * Math.PI) + (x - 0.5) * Math.log(t) - t + Math.log(sum)
}

function betaFraction(a, b, x) {
  // Continued fraction of the incomplete beta function, by Lentz's method.
  const tiny = 1e-300
  let c = 1, d = 1 - (a + b) * x / (a + 1)
  d = 1 / (Math.abs(d) < tiny ? tiny : d)
  let h = d
  for (let m = 1; m < 2000; m++) {
    const even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m))
    const odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
    let change = 1
    for (const term of [even, odd]) {
      d = 1 + term * d; c = 1 + term / c
      d = 1 / (Math.abs(d) < tiny ? tiny : d); c = Math.abs(c) < tiny ? tiny : c
      change = c * d; h *= change
    }
    if (Math.abs(change - 1) < 1e-14) break
  }
  return h
}

function incompleteBeta(a, b, x) {
  if (x <= 0 || x >= 1) return x <= 0 ? 0 : 1
  const front = Math.exp(logGamma(a + b) - logGamma(a) - logGamma(b) + a * Math.log(x) + b * Math.log1p(-x))
  return x < (a + 1) / (a + b + 2) ? front * betaFraction(a, b, x) / a : 1 - front * betaFraction(b, a, 1 - x) / b
}

function betaQuantile(a, b, level) {
  let low = 0, high = 1
  for (let i = 0; i < 60; i++) {
    const middle = 0.5 * (low + high)
    if (incompleteBeta(a, b, middle) < level) low = middle; else high = middle
  }
  return 0.5 * (low + high)
}

function exactInterval(failures, draws, confidence) {
  const tail = 0.5 * (1 - confidence)
  return [failures ? betaQuantile(failures, draws - failures + 1, tail) : 0,
    failures < draws ? betaQuantile(failures + 1, draws - failures, 1 - tail) : 1]
}

function counted(failed, chosen) {
  let failures = 0
  for (const i of chosen) failures += failed[i]
  return failures
}

function histogram(values, edges, chosen) {
  const counts = new Array(edges.length - 1).fill(0), low = edges[0], bins = counts.length
  const scale = bins / (edges[bins] - low)
  for (const i of chosen) {
    const bin = Math.min(bins - 1, Math.floor((values[i] - low) * scale))
    if (bin >= 0) counts[bin] += 1
  }
  return counts
}

function edgesOf(values, bins) {
  let low = Infinity, high = -Infinity
  for (const value of values) if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value) }
  if (!(low < high)) { const middle = Number.isFinite(low) ? low : 0; low = middle - 0.5; high = middle + 0.5 }
  return Array.from({ length: bins + 1 }, (_, i) => low + (high - low) * i / bins)
}

function describe(failures, draws, interval, whole) {
  const text = value => {
    const short = Number(value.toPrecision(3)), complement = Number((1 - value).toPrecision(2))
    return (short == 1 && value < 1 ? Number((1 - complement).toPrecision(12)) : short).toString()
  }
  const what = whole ? "all" : "brushed:"
  if (!draws) return "nothing brushed"
  return `${what} ${draws.toLocaleString("en")} draws, ${failures.toLocaleString("en")} fail: ` +
    `probability ${text(failures / draws)} in [${text(interval[0])}, ${text(interval[1])}] (95 % Clopper-Pearson)`
}

// The scatter is a picture that is painted here: a figure's own marks take seconds where there are 100,000.

function placesOf(source, ranges, image) {
  // Where each draw lies in the picture [pixels], by its index.
  const [rows, columns] = image.shape, { x, y } = source.data
  const across = columns / (ranges.x.end - ranges.x.start), up = rows / (ranges.y.end - ranges.y.start)
  return i => [(x[i] - ranges.x.start) * across, (y[i] - ranges.y.start) * up]
}

function marks(reach, columns) {
  // Where the pixels of a circle and of a cross lie relative to their middle.
  const circle = [], cross = []
  for (let a = -reach; a <= reach; a++)
    for (let b = -reach; b <= reach; b++) {
      if (a * a + b * b <= reach * reach) circle.push(b * columns + a)
      if (Math.abs(a) == Math.abs(b)) cross.push(b * columns + a)
    }
  return [circle, cross]
}

function paintDraws(source, picture, ranges, reach, colours) {
  const image = picture.data.image[0], [rows, columns] = image.shape, { x, y, failed } = source.data
  const left = ranges.x.start, across = columns / (ranges.x.end - left)
  const low = ranges.y.start, up = rows / (ranges.y.end - low)
  const pixels = marks(reach, columns), chosen = chosenDraws(source)
  const mark = (i, looks) => {
    const column = Math.round((x[i] - left) * across), row = Math.round((y[i] - low) * up)
    // a mark that is not wholly inside, or has no place, is left out
    if (!(column >= reach && column < columns - reach && row >= reach && row < rows - reach)) return
    const middle = row * columns + column, own = pixels[failed[i]], colour = looks[failed[i]]
    for (let k = 0; k < own.length; k++) image[middle + own[k]] = colour
  }
  image.fill(0)
  const others = chosen.length ? colours.dim : colours.bright
  for (let i = 0; i < failed.length; i++) mark(i, others)
  for (let k = 0; k < chosen.length; k++) mark(chosen[k], colours.bright)
  Object.assign(picture.data, { x: [left], y: [low], dw: [ranges.x.end - left], dh: [ranges.y.end - low] })
  picture.change.emit()
}

function heightsOf(source, names, lows, highs) {
  // Where each draw crosses the parallel axes, from 0 to 1, by axis and index.
  const columns = names.map(name => source.data[name])
  return (axis, i) => (columns[axis][i] - lows[axis]) / (highs[axis] - lows[axis])
}

function paintLines(source, picture, names, lows, highs, place, colours) {
  // Where many lines cross, a pixel tells by its opacity how many, and by its colour which part of them fails.
  const image = picture.data.image[0], [rows, columns] = image.shape
  const failed = source.data.failed, chosen = chosenDraws(source), height = heightsOf(source, names, lows, highs)
  const across = names.map((_, axis) => Math.round((axis + place.left) / place.across * (columns - 1)))
  const up = value => (value + place.margin) / (1 + 2 * place.margin) * (rows - 1)
  const cross = (i, crossings) => {
    for (let axis = 0; axis + 1 < names.length; axis++) {
      const from = up(height(axis, i)), to = up(height(axis + 1, i)), width = across[axis + 1] - across[axis]
      if (!Number.isFinite(from + to)) continue
      const steps = Math.max(width, Math.ceil(Math.abs(to - from)))
      for (let k = 0; k <= steps; k++) {
        const row = Math.round(from + (to - from) * k / steps), column = across[axis] + Math.round(width * k / steps)
        crossings[row * columns + column] += 1
      }
    }
  }
  const paint = (count, draw, looks) => {
    const crossings = [new Uint16Array(image.length), new Uint16Array(image.length)]
    const step = Math.max(1, Math.ceil(count / place.most)), one = place.thinnest * Math.sqrt(Math.min(1, 100 * step / count))
    for (let k = 0; k < count; k += step) cross(draw(k), crossings[failed[draw(k)]])
    for (let p = 0; p < image.length; p++) {
      const passing = crossings[0][p], failing = crossings[1][p]
      if (passing + failing) image[p] = mixed(looks, failing / (passing + failing), 1 - (1 - one) ** (passing + failing))
    }
  }
  image.fill(0)
  paint(failed.length, k => k, chosen.length ? colours.dim : colours.bright)
  paint(chosen.length, k => chosen[k], colours.bright)
  picture.change.emit()
}

function mixed([some, others], part, opacity) {
  // A pixel between two colours of equal opacity, less opaque than these.
  let pixel = Math.round((some >>> 24) * opacity) << 24
  for (const shift of [0, 8, 16]) {
    const from = some >>> shift & 255, to = others >>> shift & 255
    pixel |= Math.round(from + (to - from) * part) << shift
  }
  return pixel >>> 0
}

function betweenAxes(source, names, lows, highs, box) {
  // Indices of the draws that cross every parallel axis within the box inside the box; none if no axis is within it.
  const height = heightsOf(source, names, lows, highs), indices = []
  const [left, right] = [Math.min(box.x0, box.x1), Math.max(box.x0, box.x1)]
  const [low, high] = [Math.min(box.y0, box.y1), Math.max(box.y0, box.y1)]
  const axes = names.map((_, axis) => axis).filter(axis => axis >= left && axis <= right)
  const isIn = i => axes.every(axis => height(axis, i) >= low && height(axis, i) <= high)
  if (axes.length) for (let i = 0; i < source.data.failed.length; i++) if (isIn(i)) indices.push(i)
  return indices
}

if (!globalThis.brushing) {
  // Whether Shift is held, which adds to the brushed draws: Bokeh's event does not tell. Escape ends every brush.
  const state = { adds: false, before: [], drawn: new Map(), brushed: new Set(), waiting: 0 }
  globalThis.brushing = state
  for (const kind of ["pointerdown", "pointermove", "pointerup"])
    document.addEventListener(kind, event => { state.adds = event.shiftKey }, true)
  document.addEventListener("keydown", event => {
    if (event.key != "Escape") return
    state.adds = false
    for (const source of state.brushed) choose(source, null, [], true)
  })
}

function drawsAt(source, names, values) {
  // Indices of the draws at a point of the sweep.
  const columns = names.map(name => source.data[name]), indices = []
  for (let i = 0; i < source.data.failed.length; i++)
    if (columns.every((column, axis) => column[i] == values[axis])) indices.push(i)
  return indices
}

function whenCalm(paint) {
  // Paint once a quick succession of changes pauses.
  clearTimeout(globalThis.brushing.waiting)
  globalThis.brushing.waiting = setTimeout(paint, 250)
}

function chosenDraws(source) {
  // Indices of the brushed draws: those in the box while it is drawn, then the selected ones.
  return globalThis.brushing.drawn.get(source) ?? source.selected.indices
}

function choose(source, show, found, final) {
  // Brush the draws that were found, with Shift in addition to those brushed before.
  const state = globalThis.brushing
  state.brushed.add(source)
  const chosen = state.adds ? joined(state.before, found, source.data.failed.length) : found
  if (!final) {
    // Bokeh compares and checks every selected index, which is too slow for each movement of the mouse.
    state.drawn.set(source, chosen)
    show.execute(source)
    return
  }
  state.drawn.delete(source)
  state.before = chosen
  source.selected.indices = chosen
}

function joined(some, others, count) {
  // The indices in one list or the other, in order.
  const isIn = new Uint8Array(count), indices = []
  for (const i of some) isIn[i] = 1
  for (const i of others) isIn[i] = 1
  for (let i = 0; i < count; i++) if (isIn[i]) indices.push(i)
  return indices
}

function say(text, source, div) {
  // Show a text. The model's own text, a change of which lays the whole page out again, waits until the box is drawn.
  const view = Bokeh.index.find_one(div)
  if (view) view.markup_el.textContent = text
  if (!globalThis.brushing.drawn.has(source)) div.text = text
}

function enclosed(source, geometry) {
  // Indices of the draws in a box or a polygon of the figure.
  const { x, y } = source.data, indices = [], corners = geometry.x, heights = geometry.y
  const inBox = i => x[i] >= Math.min(geometry.x0, geometry.x1) && x[i] <= Math.max(geometry.x0, geometry.x1) &&
    y[i] >= Math.min(geometry.y0, geometry.y1) && y[i] <= Math.max(geometry.y0, geometry.y1)
  const inPolygon = i => {
    let inside = false
    for (let a = 0, b = corners.length - 1; a < corners.length; b = a++)
      if (heights[a] > y[i] != heights[b] > y[i] &&
        x[i] < corners[a] + (corners[b] - corners[a]) * (y[i] - heights[a]) / (heights[b] - heights[a])) inside = !inside
    return inside
  }
  const isIn = geometry.type == "rect" ? inBox : inPolygon
  for (let i = 0; i < x.length; i++) if (isIn(i)) indices.push(i)
  return indices
}

function nearestDraw(source, ranges, image, x, y) {
  // The index of the draw at most ten pixels from a click, as a list; none otherwise.
  const place = placesOf(source, ranges, image), [rows, columns] = image.shape
  const column = (x - ranges.x.start) / (ranges.x.end - ranges.x.start) * columns
  const row = (y - ranges.y.start) / (ranges.y.end - ranges.y.start) * rows
  let best = 100, found = []
  for (let i = 0; i < source.data.x.length; i++) {
    const [a, b] = place(i), distance = (a - column) ** 2 + (b - row) ** 2
    if (distance <= best) { best = distance; found = [i] }
  }
  return found
}

function extentOf(values) {
  // The ends of an axis that shows all finite values, with a margin.
  const edges = edgesOf(values, 1), margin = 0.04 * (edges[1] - edges[0])
  return [edges[0] - margin, edges[1] + margin]
}

function showAll(source, ranges, paint) {
  // Let the axes show all draws.
  for (const axis of ["x", "y"]) {
    const [start, end] = extentOf(source.data[axis])
    ranges[axis].setv({ start: start, end: end })
  }
  paint.execute(source)
}

function changeAxis(source, axis, name, label, bars, labelled) {
  // Put another column on an axis of the scatter, and its histogram beside it.
  const values = source.data[name]
  source.data[axis] = values
  const edges = edgesOf(values, 40)
  bars.data = { left: edges.slice(0, -1), right: edges.slice(1), all: histogram(values, edges, values.keys()),
    brushed: new Array(40).fill(0), failed: new Array(40).fill(0) }
  for (const shown of labelled) shown.axis_label = label
}

function countBrushed(source, summary, bars, level, note) {
  // Say how many of the brushed draws fail, and fill the histograms.
  const indices = chosenDraws(source), failed = source.data.failed, all = indices.length == 0
  const draws = all ? failed.length : indices.length
  const failures = counted(failed, all ? failed.keys() : indices)
  say(describe(failures, draws, exactInterval(failures, draws, level), all) + note, source, summary)
  const failing = (all ? [...failed.keys()] : indices).filter(i => failed[i])
  for (const axis of ["x", "y"]) {
    const { left, right } = bars[axis].data, values = source.data[axis]
    const edges = [...left, right[right.length - 1]]
    bars[axis].data.brushed = histogram(values, edges, indices)
    bars[axis].data.failed = histogram(values, edges, failing)
    bars[axis].change.emit()
  }
}

function showClicked(source, command, picked, start, axes) {
  // Give the command that replays the clicked draw, and tell the program behind the page.
  const indices = source.selected.indices
  if (indices.length != 1) return
  const i = indices[0], draw = source.data.draw[i]
  const point = axes.map(name => ` --at ${name}=${source.data[name][i]}`).join("")
  command.text = `draw ${draw} ${source.data.failed[i] ? "fails" : "passes"}: ${start}${draw}${point}`
  picked.data = { row: [i] }
}

// Ways as thick lines. Each piece of one costs a processor that draws as much as a whole bar, so that a way keeps no more
// points than it needs.
import { Line2 } from 'three/addons/lines/Line2.js'
import { LineGeometry } from 'three/addons/lines/LineGeometry.js'
import { LineMaterial } from 'three/addons/lines/LineMaterial.js'

/** What is left out lies nearer than this to what is drawn, m. */
const NEAR = 0.002

/** Points of a way, `[x, y, z, …]`, that tell it: those of Ramer, Douglas and Peucker. */
function told(places) {
  const last = places.length / 3 - 1
  const kept = new Uint8Array(last + 1)
  kept[0] = kept[last] = 1
  const open = [[0, last]]
  while (open.length) {
    const [from, to] = open.pop()
    const [a, b] = [3 * from, 3 * to]
    const way = [0, 1, 2].map((k) => places[b + k] - places[a + k])
    const length = way[0] ** 2 + way[1] ** 2 + way[2] ** 2
    let [most, at] = [NEAR * NEAR, -1]
    for (let i = from + 1; i < to; i++) {
      const [x, y, z] = [0, 1, 2].map((k) => places[3 * i + k] - places[a + k])
      const share = length ? Math.min(1, Math.max(0, (x * way[0] + y * way[1] + z * way[2]) / length)) : 0
      const away = (x - share * way[0]) ** 2 + (y - share * way[1]) ** 2 + (z - share * way[2]) ** 2
      if (away > most) [most, at] = [away, i]
    }
    if (at < 0) continue
    kept[at] = 1
    open.push([from, at], [at, to])
  }
  return kept
}

/** A way that is drawn up to a frame. */
export class Trail {
  constructor(colour, width, more) {
    this.line = new Line2(new LineGeometry(), new LineMaterial({ color: colour, linewidth: width, ...more }))
    this.line.frustumCulled = false
    this.line.visible = false
    this.frames = []
  }

  /** Through the places of frames from 0 on. */
  lay(places) {
    const kept = told(places)
    this.frames = [...kept.keys()].filter((k) => kept[k])
    const { line } = this
    line.geometry.dispose()
    line.geometry = new LineGeometry().setPositions(this.frames.flatMap((k) => [...places.subarray(3 * k, 3 * k + 3)]))
    if (line.material.dashed) line.computeLineDistances()
    this.cut = undefined
  }

  /** All of it, or none. */
  show(on) {
    this.line.visible = on && this.frames.length > 1
  }

  /** Up to a frame, at which it is at this place: the piece that leads there ends there. */
  upTo(frame, place) {
    const { data } = this.line.geometry.attributes.instanceStart
    if (this.cut) data.array.set(this.cut.end, this.cut.at)
    let piece = this.frames.findIndex((k) => k >= frame) - 1
    if (piece === -2) piece = this.frames.length - 2
    piece = Math.max(0, piece)
    const at = 6 * piece + 3
    this.cut = { at, end: data.array.slice(at, at + 3) }
    place.toArray(data.array, at)
    data.needsUpdate = true
    this.line.geometry.instanceCount = piece + 1
  }
}

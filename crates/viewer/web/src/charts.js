// Curves under the time line: errors and thrusts of everybody, with what happened marked.
import { nth } from './vehicle.js'

const INK = '#4b5563'

/** What is drawn of a flight: title, unit, and per curve its colour and value by frame. */
export function curves(flight) {
  const one = flight.actors.length === 1
  const panels = []
  const told = flight.actors.find((actor) => actor.error)
  if (told) {
    panels.push({
      title: `${told.error.name} [${told.error.unit}]`,
      lines: flight.actors.filter((a) => a.error).map((a, i) => ({ colour: nth(i), last: () => flight.last(a), value: (k) => flight.error(a, k) })),
    })
  }
  const rotors = one ? flight.actors[0].look.bodies.flatMap((b) => b.rotors) : []
  if (one && rotors.length <= 6) {
    panels.push({
      title: 'thrust of every rotor [N]',
      lines: rotors.map((r) => ({
        colour: nth(r.number),
        last: () => flight.last(flight.actors[0]),
        value: (k) => r.max_thrust * flight.speed(flight.actors[0], r.number, k) ** 2,
      })),
    })
  } else {
    panels.push({
      title: one ? 'thrust of all rotors [N]' : 'thrust [N]',
      lines: flight.actors.map((a, i) => ({ colour: nth(i), last: () => flight.last(a), value: (k) => flight.thrust(a, k) })),
    })
  }
  return panels
}

/** A round number above. */
function ceiling(most) {
  const power = 10 ** Math.floor(Math.log10(most))
  return power * [1, 1.5, 2, 3, 4, 5, 6, 8, 10].find((x) => x * power >= most * 0.999)
}

/** A panel that is drawn once and whose cursor moves. */
export class Chart {
  constructor(canvas, flight, panel, duration) {
    Object.assign(this, { canvas, flight, panel, duration })
    this.still = document.createElement('canvas')
  }

  /** Curves of all frames there are, in the size that the page gives. */
  redraw() {
    const { canvas, flight, panel, still } = this
    const ratio = Math.min(2, window.devicePixelRatio || 1)
    const [width, height] = [canvas.clientWidth, canvas.clientHeight]
    if (!width || !height) return
    for (const c of [canvas, still]) [c.width, c.height] = [width * ratio, height * ratio]
    const g = still.getContext('2d')
    g.scale(ratio, ratio)
    this.area = { x: 38, y: 18, w: width - 46, h: height - 24 }
    const { x, y, w, h } = this.area
    const duration = this.duration()
    let most = 0
    for (const line of panel.lines) {
      for (let k = 0; k <= line.last(); k++) most = Math.max(most, line.value(k))
    }
    const top = ceiling(most || 1)
    g.font = '11px system-ui, sans-serif'
    g.fillStyle = INK
    g.fillText(panel.title, x, 11)
    g.textAlign = 'right'
    g.strokeStyle = '#d5dce3'
    g.lineWidth = 1
    for (const share of [0, 0.5, 1]) {
      const at = Math.round(y + h * (1 - share)) + 0.5
      g.beginPath()
      g.moveTo(x, at)
      g.lineTo(x + w, at)
      g.stroke()
      g.fillText(Number((top * share).toPrecision(3)), x - 5, at + 4)
    }
    for (const event of flight.events) {
      const at = x + (w * event.time) / duration
      g.strokeStyle = '#c1121f'
      g.setLineDash([3, 3])
      g.beginPath()
      g.moveTo(at, y)
      g.lineTo(at, y + h)
      g.stroke()
      g.setLineDash([])
    }
    g.lineWidth = 1.5
    g.lineJoin = 'round'
    for (const line of panel.lines) {
      g.strokeStyle = line.colour
      g.beginPath()
      const last = line.last()
      const stride = Math.max(1, Math.floor(last / (2 * w)))
      for (let k = 0; k <= last; k += stride) {
        g.lineTo(x + (w * k * flight.interval) / duration, y + h * (1 - Math.min(line.value(k), top) / top))
      }
      g.stroke()
    }
    this.frames = flight.frames
  }

  show(time) {
    if (!this.area || this.flight.frames > this.frames + 10) this.redraw()
    if (!this.area) return
    const g = this.canvas.getContext('2d')
    const ratio = this.canvas.width / this.canvas.clientWidth
    g.setTransform(1, 0, 0, 1, 0, 0)
    g.clearRect(0, 0, this.canvas.width, this.canvas.height)
    g.drawImage(this.still, 0, 0)
    g.scale(ratio, ratio)
    const { x, y, w, h } = this.area
    const at = x + (w * Math.min(time, this.duration())) / (this.duration() || 1)
    g.strokeStyle = '#111827'
    g.lineWidth = 1
    g.beginPath()
    g.moveTo(at, y - 3)
    g.lineTo(at, y + h)
    g.stroke()
    const frame = this.flight.frame(time)
    const values = this.panel.lines.slice(0, 4).map((l) => [l.colour, l.value(Math.min(frame, l.last()))])
    g.font = '600 11px system-ui, sans-serif'
    g.textAlign = 'right'
    let right = x + w
    for (const [colour, value] of values.reverse()) {
      const text = value.toPrecision(3)
      g.fillStyle = colour
      g.fillText(text, right, 11)
      right -= g.measureText(text).width + 10
    }
  }

  /** Time at a place of the pointer. */
  time(event) {
    const { left } = this.canvas.getBoundingClientRect()
    const { x, w } = this.area
    return (Math.min(Math.max((event.clientX - left - x) / w, 0), 1)) * this.duration()
  }
}

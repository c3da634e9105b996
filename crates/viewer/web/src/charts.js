// Curves under the time line: errors and thrusts of everybody, with what happened marked.
import { nth } from './vehicle.js'

const INK = '#4b5563'
const FONT = '11px system-ui, sans-serif'
const BOLD = `600 ${FONT}`
/** Between two readouts, and height of a line of text, px. */
const [GAP, LINE] = [10, 14]

/** Least top of an axis of errors by their unit: smaller ones are rounding. */
const LEAST = { m: 1e-3, rad: 1e-3 }

/** What is drawn of a flight: title, least top of its axis, and per curve its colour and value by frame. */
export function curves(flight) {
  const one = flight.actors.length === 1
  const panels = []
  const told = flight.actors.find((actor) => actor.error)
  if (told) {
    panels.push({
      title: `${told.error.name} [${told.error.unit}]`,
      least: LEAST[told.error.unit] ?? 0,
      lines: flight.actors.filter((a) => a.error).map((a, i) => ({ colour: nth(i), last: () => flight.last(a), value: (k) => flight.error(a, k) })),
    })
  }
  // a hundredth of what a rotor can: idle ones stand at the bottom
  const idle = (rotors) => 0.01 * Math.max(...rotors.map((r) => r.max_thrust), 0)
  const all = (actor) => actor.look.bodies.flatMap((b) => b.rotors)
  const rotors = one ? all(flight.actors[0]) : []
  if (one && rotors.length <= 6) {
    panels.push({
      title: 'thrust of every rotor [N]',
      least: idle(rotors),
      lines: rotors.map((r) => ({
        colour: nth(r.number),
        last: () => flight.last(flight.actors[0]),
        value: (k) => r.max_thrust * flight.speed(flight.actors[0], r.number, k) ** 2,
      })),
    })
  } else {
    panels.push({
      title: one ? 'thrust of all rotors [N]' : 'thrust [N]',
      least: Math.max(...flight.actors.map((a) => all(a).length * idle(all(a)))),
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
  /** `kindred` are the charts of the same title, this one too: they share a scale, so that flights beside each other compare. */
  constructor(canvas, flight, panel, duration, kindred = () => [this]) {
    Object.assign(this, { canvas, flight, panel, duration, kindred })
    this.still = document.createElement('canvas')
  }

  /** The largest number of all its frames so far. */
  most() {
    let most = this.panel.least
    for (const line of this.panel.lines) {
      for (let k = 0; k <= line.last(); k++) most = Math.max(most, line.value(k))
    }
    return most
  }

  /** The readouts at a time: colour and text of each curve. */
  readouts(time) {
    const frame = this.flight.frame(time)
    return this.panel.lines.map((l) => [l.colour, l.value(Math.min(frame, l.last())).toFixed(this.told.decimals)])
  }

  /** Where readouts of an axis up to `top` stand, and with how many decimals: beside the title, below it, or nowhere. */
  arrange(g, width, top) {
    g.font = FONT
    const title = g.measureText(this.panel.title).width
    g.font = BOLD
    const n = this.panel.lines.length
    for (const [row, room] of [[0, width - title - 2 * GAP], [1, width]]) {
      for (const digits of [3, 2]) {
        const decimals = Math.max(0, digits - 1 - Math.floor(Math.log10(top)))
        if (n * g.measureText(top.toFixed(decimals)).width + (n - 1) * GAP <= room) return { row, decimals }
      }
    }
    return { row: 0, decimals: undefined }
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
    const top = this.top = ceiling(Math.max(...this.kindred().map((chart) => chart.most())) || 1)
    const ticks = [0, 0.5, 1].map((share) => [share, String(Number((top * share).toPrecision(3)))])
    g.font = FONT
    const left = Math.max(38, 9 + Math.max(...ticks.map(([, label]) => g.measureText(label).width)))
    this.told = this.arrange(g, width - left - 8, top)
    const y = 18 + LINE * this.told.row
    this.area = { x: left, y, w: width - left - 8, h: height - 6 - y }
    const { x, w, h } = this.area
    const duration = this.duration()
    g.font = FONT
    g.fillStyle = INK
    g.fillText(panel.title, x, 11, w)
    g.textAlign = 'right'
    g.strokeStyle = '#d5dce3'
    g.lineWidth = 1
    for (const [share, label] of ticks) {
      const at = Math.round(y + h * (1 - share)) + 0.5
      g.beginPath()
      g.moveTo(x, at)
      g.lineTo(x + w, at)
      g.stroke()
      g.fillText(label, x - 5, at + 4)
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
    const { decimals, row } = this.told
    if (decimals === undefined) return
    g.font = BOLD
    g.textAlign = 'right'
    let right = x + w
    for (const [colour, text] of this.readouts(time).reverse()) {
      g.fillStyle = colour
      g.fillText(text, right, 11 + LINE * row)
      right -= g.measureText(text).width + GAP
    }
  }

  /** Time at a place of the pointer. */
  time(event) {
    const { left } = this.canvas.getBoundingClientRect()
    const { x, w } = this.area
    return (Math.min(Math.max((event.clientX - left - x) / w, 0), 1)) * this.duration()
  }
}

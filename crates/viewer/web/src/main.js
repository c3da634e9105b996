// The page: flights beside each other, one clock, one camera, curves and controls below.
import { Vector2, WebGLRenderer } from 'three'
import { Flight } from './data.js'
import { SKY, Stage } from './stage.js'
import { CAMERAS, Cameras } from './cameras.js'
import { Chart, curves } from './charts.js'
import { listen } from './live.js'

const $ = (id) => document.getElementById(id)
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4]

/** Frames slower than this make the picture coarser, s. */
const SLOW = 0.04

/** Whether a processor draws: smooth edges then cost more than the picture. */
function drawnBySoftware() {
  const gl = document.createElement('canvas').getContext('webgl2')
  const name = gl?.getExtension('WEBGL_debug_renderer_info')
  const drawn = name ? gl.getParameter(name.UNMASKED_RENDERER_WEBGL) : ''
  gl?.getExtension('WEBGL_lose_context')?.loseContext()
  return /swiftshader|llvmpipe|software/i.test(drawn)
}

class Viewer {
  constructor(recordings) {
    this.canvas = $('view')
    this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: !drawnBySoftware(), stencil: true, powerPreference: 'high-performance' })
    this.renderer.setClearColor(SKY)
    this.renderer.setScissorTest(true)
    this.options = { trails: true, forces: false, reference: true, sensors: true }
    this.speed = 1
    this.playing = false
    this.time = 0
    this.dirty = true
    this.begin(recordings)
    this.connect()
    this.last = performance.now()
    requestAnimationFrame(() => this.tick())
  }

  begin(recordings) {
    this.flights = recordings.map((r) => new Flight(r))
    this.stages = this.flights.map((f) => new Stage(f))
    this.cameras?.controls.dispose()
    this.cameras = new Cameras(this.stages, this.canvas)
    this.cameras.controls.addEventListener('change', () => (this.dirty = true))
    this.time = 0
    this.tell()
    this.resize()
  }

  get duration() {
    return Math.max(...this.flights.map((f) => f.duration), 1e-9)
  }

  /** Titles, facts, curves. */
  tell() {
    $('titles').replaceChildren(...this.flights.map((flight) => {
      const box = document.createElement('section')
      const name = box.appendChild(document.createElement('h1'))
      name.textContent = flight.title
      const remark = box.appendChild(document.createElement('p'))
      remark.textContent = flight.remark
      flight.told = box.appendChild(document.createElement('p'))
      flight.told.className = 'event'
      const facts = box.appendChild(document.createElement('dl'))
      for (const [what, value] of flight.facts) {
        facts.appendChild(document.createElement('dt')).textContent = what
        facts.appendChild(document.createElement('dd')).textContent = value
      }
      return box
    }))
    document.body.classList.toggle('several', this.flights.length > 1)
    $('charts').replaceChildren()
    this.charts = this.flights.flatMap((flight) => curves(flight).map((panel, k) => {
      const canvas = $('charts').appendChild(document.createElement('canvas'))
      canvas.setAttribute('role', 'img')
      canvas.setAttribute('aria-label', panel.title)
      // beside another flight a narrow page has room for the first panel of each
      canvas.classList.toggle('more', k > 0)
      const kindred = () => this.charts.filter((chart) => chart.panel.title === panel.title)
      return new Chart(canvas, flight, panel, () => this.duration, kindred)
    }))
    for (const chart of this.charts) this.scrub(chart.canvas, (event) => chart.time(event))
    $('marks').replaceChildren(...this.flights.flatMap((flight) => flight.events.map((event) => {
      const mark = document.createElement('i')
      mark.style.left = `${(100 * event.time) / this.duration}%`
      mark.title = event.text
      return mark
    })))
  }

  /** A pointer that is held down upon an element moves the clock. */
  scrub(element, time) {
    const move = (event) => event.buttons && this.seek(time(event))
    element.addEventListener('pointerdown', (event) => {
      element.setPointerCapture(event.pointerId)
      this.held = this.playing
      this.play(false)
      this.seek(time(event))
    })
    element.addEventListener('pointermove', move)
    element.addEventListener('pointerup', () => this.play(this.held))
  }

  connect() {
    $('play').onclick = () => this.play(!this.playing)
    $('time').oninput = () => this.seek(Number($('time').value) * this.duration)
    $('speed').onclick = () => this.pace(1)
    $('drone').onclick = () => this.changed(() => this.cameras.next())
    $('home').onclick = () => this.changed(() => this.cameras.home())
    $('about').onclick = () => document.body.classList.toggle('told')
    for (const [i, name] of CAMERAS.entries()) $(`camera${i}`).onclick = () => this.look(name)
    for (const what of Object.keys(this.options)) $(what).onclick = () => this.toggle(what)
    window.addEventListener('resize', () => this.resize())
    window.addEventListener('keydown', (event) => this.key(event))
    for (const what of ['pointerdown', 'pointermove', 'wheel', 'touchmove']) {
      this.canvas.addEventListener(what, () => (this.dirty = true), { passive: true })
    }
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return
    const step = event.shiftKey ? 1 : this.flights[0].interval
    const keys = {
      ' ': () => this.play(!this.playing),
      ArrowRight: () => this.seek(this.time + step),
      ArrowLeft: () => this.seek(this.time - step),
      Home: () => this.seek(0),
      End: () => this.seek(this.duration),
      '+': () => this.pace(1),
      '-': () => this.pace(-1),
      1: () => this.look(CAMERAS[0]),
      2: () => this.look(CAMERAS[1]),
      3: () => this.look(CAMERAS[2]),
      n: () => $('drone').click(),
      c: () => $('home').click(),
      t: () => this.toggle('trails'),
      f: () => this.toggle('forces'),
      r: () => this.toggle('reference'),
      s: () => this.toggle('sensors'),
      i: () => $('about').click(),
    }
    const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key]
    if (!act) return
    event.preventDefault()
    act()
  }

  changed(act) {
    act()
    this.dirty = true
    this.buttons()
  }

  look(name) {
    this.changed(() => this.cameras.choose(name))
  }

  toggle(what) {
    this.changed(() => (this.options[what] = !this.options[what]))
  }

  /** The next speed up or down, round and round. */
  pace(by) {
    const at = SPEEDS.indexOf(this.speed) + by
    this.changed(() => (this.speed = SPEEDS[(at + SPEEDS.length) % SPEEDS.length]))
  }

  play(on) {
    this.changed(() => {
      if (on && this.time >= this.duration) this.time = 0
      this.playing = on
      this.live = on && this.live
    })
  }

  seek(time) {
    this.changed(() => {
      this.time = Math.min(Math.max(time, 0), this.duration)
      this.live = false
    })
  }

  buttons() {
    $('play').textContent = this.playing ? '❚❚' : '▶'
    $('play').setAttribute('aria-label', this.playing ? 'pause' : 'play')
    $('speed').textContent = `${this.speed}×`
    CAMERAS.forEach((name, i) => $(`camera${i}`).classList.toggle('on', this.cameras.mode === name))
    for (const [what, on] of Object.entries(this.options)) $(what).classList.toggle('on', on)
    $('sensors').hidden = this.flights.every((f) => f.actors.every((a) => !a.mounts))
    $('drone').hidden = this.stages.every((s) => s.drones.length < 2)
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas.parentElement
    this.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio || 1) * (this.plain ? 0.6 : 1))
    this.renderer.setSize(clientWidth, clientHeight, false)
    for (const chart of this.charts) chart.redraw()
    this.dirty = true
    this.buttons()
  }

  /** Fewer pixels where pictures take too long. */
  ease(seconds) {
    // the first ones wait for programs that are compiled
    this.eased = (this.eased ?? 0) + 1
    if (this.eased < 40) return
    this.mean = 0.95 * (this.mean ?? 0.016) + 0.05 * Math.min(seconds, 0.2)
    if (this.mean < SLOW || this.plain) return
    this.plain = true
    this.resize()
  }

  tick() {
    const now = performance.now()
    const seconds = Math.min((now - this.last) / 1000, 0.1)
    this.last = now
    if (this.playing) {
      this.time = this.live ? this.duration : this.time + this.speed * seconds
      if (this.time >= this.duration && !this.live) {
        this.time = this.duration
        if (!this.following) this.changed(() => (this.playing = false))
      }
      this.ease(seconds)
    }
    if (this.playing || this.dirty) this.draw(this.playing ? this.speed * seconds : 0)
    requestAnimationFrame(() => this.tick())
  }

  draw(seconds = 0) {
    this.dirty = false
    for (const stage of this.stages) stage.show(this.time, this.options, seconds)
    for (const stage of this.stages) stage.scene.updateMatrixWorld()
    if (this.cameras.update()) this.dirty = true
    const { x: width, y: height } = this.renderer.getSize(new Vector2())
    const many = this.stages.length
    this.stages.forEach((stage, i) => {
      const [x, w] = [Math.round((width * i) / many), Math.round(width / many)]
      const camera = this.cameras.of(i, w / height)
      stage.only(this.cameras.mode === 'on board' ? this.cameras.drone : null)
      this.renderer.setViewport(x, 0, w, height)
      this.renderer.setScissor(x, 0, w, height)
      stage.draw(this.renderer, camera)
    })
    for (const chart of this.charts) chart.show(this.time)
    $('time').value = this.time / this.duration
    $('clock').textContent = `${this.time.toFixed(2)} / ${this.duration.toFixed(2)} s`
    for (const { events, told } of this.flights) {
      const now = events.filter((e) => e.time <= this.time && this.time < e.time + 3)
      told.textContent = now.map((e) => e.text).join(' · ')
    }
  }
}

/** What the address asks for behind its `#`: `t=3.5&camera=follow&play=1`. */
function asked(viewer) {
  const words = new URLSearchParams(location.hash.slice(1))
  if (words.has('t')) viewer.seek(Number(words.get('t')) || 0)
  if (CAMERAS.includes(words.get('camera'))) viewer.look(words.get('camera'))
  return words.get('play') !== '0'
}

const start = (recordings) => {
  window.viewer = new Viewer(recordings)
  return window.viewer
}

try {
  const recordings = JSON.parse($('flights').textContent)
  if (recordings.length > 0) {
    const viewer = start(recordings)
    viewer.play(asked(viewer))
  } else {
    listen(start)
  }
} catch (error) {
  // without WebGL there is nothing to see, and the reader should know why
  $('titles').textContent = `This page needs WebGL: ${error.message}`
  throw error
}

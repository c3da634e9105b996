// One flight in space: ground, light, who flies, where they were and are wanted, what pushes them.
import {
  Box3, BufferAttribute, BufferGeometry, Color, DirectionalLight, DoubleSide, EqualStencilFunc, Fog, Group, HemisphereLight,
  IncrementStencilOp, LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial, MeshLambertMaterial, PerspectiveCamera, Quaternion, Scene, Vector3,
} from 'three'
import { Trail } from './trail.js'
import { Propellers, SHADOWS, Vehicle, arrow, nth, obstacle, point, sensor, target } from './vehicle.js'

/** Ground and sky are one: what covers the whole picture costs most of it where a processor draws. */
export const SKY = '#e4e9ee'
/** Half width of the grid, m. */
const FIELD = 30
/** Towards the light. */
const SUN = new Vector3(0.45, -0.35, 1)
/** Of bodies along the light onto the ground, a little above it. */
const FLATTEN = new Matrix4().set(1, 0, -SUN.x / SUN.z, 0, 0, 1, -SUN.y / SUN.z, 0, 0, 0, 0, 0.002, 0, 0, 0, 1)
const SHADOW = new MeshBasicMaterial({
  color: '#3d4b5c', transparent: true, opacity: 0.26, depthWrite: false, side: DoubleSide,
  stencilWrite: true, stencilRef: 0, stencilFunc: EqualStencilFunc, stencilZPass: IncrementStencilOp,
})
const [V, W, Q] = [new Vector3(), new Vector3(), new Quaternion()]

/** Lines every metre, every fifth one darker, paler towards the rim. */
function grid() {
  const places = []
  const colours = []
  const far = new Color(SKY)
  const line = (a, b, near) => {
    const parts = 12
    for (let k = 0; k < parts; k++) {
      for (const s of [k / parts, (k + 1) / parts]) {
        const [x, y] = [a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1])]
        places.push(x, y, 0)
        const colour = new Color(near).lerp(far, Math.min(1, Math.hypot(x, y) / FIELD))
        colours.push(colour.r, colour.g, colour.b)
      }
    }
  }
  for (let k = -FIELD; k <= FIELD; k++) {
    const near = k % 5 ? '#cdd5dc' : '#aeb9c4'
    const half = Math.sqrt(FIELD * FIELD - k * k)
    line([k, -half], [k, half], near)
    line([-half, k], [half, k], near)
  }
  const geometry = new BufferGeometry()
  geometry.setAttribute('position', new BufferAttribute(new Float32Array(places), 3))
  geometry.setAttribute('color', new BufferAttribute(new Float32Array(colours), 3))
  return new LineSegments(geometry, new LineBasicMaterial({ vertexColors: true, fog: false }))
}

class Player {
  constructor(flight, actor, colour, stage) {
    Object.assign(this, { flight, actor, colour })
    const { look } = actor
    this.several = flight.actors.length === 1 && look.bodies.filter((b) => b.drone != null).length > 1
    this.root = new Group()
    this.root.position.set(...actor.offset)
    this.vehicle = new Vehicle(look, colour, { several: this.several })
    this.root.add(this.vehicle.group)
    this.goals = Array.from({ length: actor.goals }, (_, i) => {
      const made = target(this.several && actor.goals > 1 ? nth(i) : colour, Math.min(0.05, Math.max(0.012, 0.12 * look.size)))
      this.root.add(made)
      return made
    })
    const drones = look.bodies.map((b, i) => (b.drone == null ? -1 : i)).filter((i) => i >= 0)
    this.traced = drones.length ? drones : [0]
    this.trails = this.traced.map((body) => new Trail(this.tint(look.bodies[body].drone ?? 0), 2.5))
    this.paths = this.goals.map(() => new Trail('#7b8794', 1.6, { dashed: true, dashSize: 0.12, gapSize: 0.09 }))
    this.thrusts = this.vehicle.rotors.map(() => arrow('#0a9396'))
    this.contacts = actor.contact ? look.bodies.map(() => arrow('#c1121f')) : []
    this.mounts = []
    this.root.add(...[...this.trails, ...this.paths].map((trail) => trail.line), ...this.contacts)
    this.vehicle.rotors.forEach((r, i) => r.group.add(this.thrusts[i]))
    this.weight = Math.max(actor.weight, 1e-3)
    actor.still.forEach((at, i) => {
      const name = JSON.stringify([look.still[i], at, actor.offset])
      if (stage.standing.has(name)) return
      stage.standing.add(name)
      const mesh = obstacle(look.still[i])
      mesh.position.set(...at)
      this.root.add(mesh)
      stage.obstacles.push(mesh)
    })
    this.trace()
  }

  tint(drone) {
    return this.several ? nth(drone) : this.colour
  }

  /** Ways of all frames there are. */
  trace() {
    const { flight, actor } = this
    this.traces = flight.frames
    const lay = (trail, last, of) => {
      if (last < 1) return
      const places = new Float32Array(3 * (last + 1))
      for (let k = 0; k <= last; k++) of(k).toArray(places, 3 * k)
      trail.lay(places)
    }
    const end = flight.last(actor)
    this.traced.forEach((body, i) => {
      lay(this.trails[i], end, (k) => flight.vector(actor.at.pose + 7 * body, k, flight.steps.position, V))
    })
    this.paths.forEach((path, i) => {
      const moves = [0, 1, 2].some((k) => {
        const column = flight.columns[actor.at.goal + 3 * i + k]
        return column.subarray(0, flight.frames).some((x) => x !== column[0])
      })
      if (moves) lay(path, flight.frames - 1, (k) => flight.goal(actor, i, k, V))
    })
  }

  show(frame, options, seconds) {
    const { flight, actor, vehicle } = this
    if (flight.frames > this.traces + 15) this.trace()
    const at = Math.min(frame, flight.last(actor))
    const ended = actor.ended && frame >= flight.last(actor)
    vehicle.bodies.forEach((body, i) => flight.pose(actor, i, at, body.position, body.quaternion))
    vehicle.rotors.forEach((rotor, i) => {
      const share = ended ? 0 : flight.speed(actor, i, at)
      vehicle.turn(i, share, seconds)
      vehicle.fail(i, flight.events.some((e) => e.rotor === i && flight.actors[e.actor] === actor && e.time <= frame * flight.interval))
      const most = vehicle.rotors[i].rotor
      point(this.thrusts[i], W.set(0, 0, 0), new Vector3(0, 0, 1), options.forces ? 4.5 * most.radius * share * share : 0)
      this.thrusts[i].scale.x = this.thrusts[i].scale.y = Math.min(1, 6 * most.radius)
    })
    this.goals.forEach((goal, i) => {
      goal.visible = options.reference
      flight.goal(actor, i, frame, goal.position)
    })
    for (const mount of this.mounts) mount.visible = options.sensors
    for (const path of this.paths) path.show(options.reference)
    this.contacts.forEach((made, i) => {
      flight.force(actor, i, at, V)
      point(made, vehicle.bodies[i].position, V, options.forces ? Math.min(1.5, V.length() / this.weight) : 0)
    })
    this.trails.forEach((trail, i) => {
      trail.show(options.trails && at > 0)
      if (trail.line.visible) trail.upTo(at, vehicle.bodies[this.traced[i]].position)
    })
    this.dim(Boolean(ended))
  }

  /** Who has crashed turns pale. */
  dim(lost) {
    if (this.lost === lost) return
    this.lost = lost
    this.vehicle.group.traverse(({ material }) => {
      if (!(material instanceof MeshLambertMaterial)) return
      material.userData.own ??= material.color.clone()
      material.color.copy(material.userData.own)
      if (lost && material.userData.tinted) material.color.lerp(new Color('#9aa4ae'), 0.8)
    })
  }

  /** Sensors: when the size of who carries them has been taken. */
  mount() {
    const { mounts = [], look } = this.actor
    this.mounts = mounts.map((mount) => sensor(mount, look.size))
    mounts.forEach(({ body }, i) => this.vehicle.bodies[body].add(this.mounts[i]))
  }

  /** Where drone i is, and how it is turned. */
  place(i, position, attitude) {
    const body = this.vehicle.bodies[this.traced[i % this.traced.length]]
    body.getWorldPosition(position)
    body.getWorldQuaternion(attitude)
  }
}

/** The scene of a flight. */
export class Stage {
  constructor(flight) {
    this.flight = flight
    this.standing = new Set()
    this.scene = new Scene()
    this.scene.fog = new Fog(SKY, 22, 60)
    this.obstacles = []
    this.scene.add(new HemisphereLight('#ffffff', '#b9c2cb', 2.1))
    const sun = new DirectionalLight('#fff6e8', 2.0)
    sun.position.copy(SUN)
    this.scene.add(sun)
    this.flat = new PerspectiveCamera()
    this.scene.add(grid())
    this.players = flight.actors.map((actor, i) => new Player(flight, actor, nth(i), this))
    for (const player of this.players) this.scene.add(player.root)
    this.propellers = new Propellers(this.players.map(({ vehicle, root }) => ({ rotors: vehicle.rotors, root })))
    this.scene.add(this.propellers.group)
    this.drones = this.players.flatMap((player) => player.traced.map((_, i) => [player, i]))
    this.show(0, { trails: true, forces: false, reference: true, sensors: true }, 0)
    this.frameAll()
    for (const player of this.players) player.mount()
  }

  show(time, options, seconds) {
    const frame = this.flight.frame(time)
    for (const player of this.players) player.show(frame, options, seconds)
  }

  /** Room of what is to be seen at the start, who flies and where they are wanted; half the size of the largest flier. */
  frameAll() {
    this.scene.updateMatrixWorld(true)
    this.room = new Box3()
    this.look = 0
    for (const player of this.players) {
      const own = new Box3().setFromObject(player.vehicle.group)
      this.look = Math.max(this.look, 0.5 * own.getSize(V).length())
      this.room.union(own)
      for (const goal of player.goals) this.room.expandByPoint(goal.getWorldPosition(V))
    }
  }

  /** Towards what stands about a place, the nearest most, level; nothing where nothing stands. */
  beset(place) {
    const ahead = new Vector3()
    for (const mesh of this.obstacles) {
      const box = new Box3().setFromObject(mesh)
      const way = box.getCenter(V).sub(place).setZ(0)
      const apart = Math.max(box.distanceToPoint(place), 0.2)
      if (way.length() > 1e-3) ahead.addScaledVector(way.normalize(), 1 / apart ** 2)
    }
    return ahead.length() > 1e-9 ? ahead.normalize() : undefined
  }

  /** What is far is paler, but never who is looked at from so far. */
  haze(distance) {
    Object.assign(this.scene.fog, { near: Math.max(22, 1.6 * distance), far: Math.max(60, 3.2 * distance) })
  }

  /** Only one player, for who looks from on board: episodes that share a room are worlds of their own. */
  only(drone) {
    const chosen = drone == null ? undefined : this.drones[drone % this.drones.length][0]
    for (const player of this.players) player.root.visible = !chosen || player === chosen
  }

  /** The picture, then shadows: all bodies once more, laid flat along the light, each pixel darkened once. */
  draw(renderer, camera) {
    this.propellers.lay()
    renderer.autoClear = true
    this.scene.overrideMaterial = null
    renderer.render(this.scene, camera)
    const flat = this.flat
    flat.copy(camera)
    flat.layers.set(SHADOWS)
    flat.matrixWorldAutoUpdate = false
    flat.matrixWorldInverse.copy(camera.matrixWorldInverse).multiply(FLATTEN)
    renderer.autoClear = false
    this.scene.overrideMaterial = SHADOW
    renderer.render(this.scene, flat)
  }

  /** How far the rotors of a drone are from its middle, m. */
  reach(drone) {
    const [player, i] = this.drones[drone % this.drones.length]
    const { rotors } = player.actor.look.bodies[player.traced[i]]
    return Math.max(0.05, ...rotors.map((r) => Math.hypot(...r.position)))
  }

  place(drone, position, attitude = Q) {
    const [player, i] = this.drones[drone % this.drones.length]
    player.place(i, position, attitude)
  }
}

// What flies, as meshes: airframes from their rotors, loads, bars and obstacles from their shapes.
import {
  BoxGeometry, BufferGeometry, CapsuleGeometry, CircleGeometry, Color, ConeGeometry, CylinderGeometry, DoubleSide,
  EdgesGeometry, Float32BufferAttribute, Group, InstancedMesh, LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial, MeshLambertMaterial,
  Quaternion, RingGeometry, SphereGeometry, TorusGeometry, Vector3,
} from 'three'
import { mergeGeometries } from 'three/addons/utils/BufferGeometryUtils.js'

/** Okabe and Ito, as in the figures. */
export const PALETTE = ['#0072b2', '#d55e00', '#009e73', '#cc79a7', '#e69f00', '#56b4e9', '#4b5563']
export const nth = (i) => PALETTE[i % PALETTE.length]

const Z = new Vector3(0, 0, 1)
const lambert = (color, more = {}) => new MeshLambertMaterial({ color, ...more })
/** Colours of their own: they pale where their bearer is lost. */
const painted = (color) => Object.assign(lambert(color), { userData: { tinted: true } })
const CARBON = lambert('#2b3138')
const METAL = lambert('#9aa4ae')
const BLADE = lambert('#15191d', { side: DoubleSide })
const CARDBOARD = lambert('#d2a86c')
const EDGE = new LineBasicMaterial({ color: '#7a5a2e' })
const BALL = lambert('#8d2f3c')
const STILL = lambert('#8fa0b2')
const LIGHT = lambert('#ffffff')
/** Of what is joined: its corners know their colours. */
const BAKED = lambert('#ffffff', { vertexColors: true })
/** Discs of rotors that turn counter-clockwise and clockwise, and of those that failed. */
const DISC = { 1: new Color('#1d8fa8'), '-1': new Color('#c9822b'), lost: new Color('#d11f2f') }

/** Layer of what throws a shadow. */
export const SHADOWS = 1

const shown = (mesh) => {
  mesh.layers.enable(SHADOWS)
  return mesh
}

/** A geometry whose corners have a colour, and an opacity where one is given. */
function tinted(geometry, { r, g, b }, opacity) {
  const one = opacity == null ? [r, g, b] : [r, g, b, opacity]
  const colours = Float32Array.from({ length: one.length * geometry.attributes.position.count }, (_, k) => one[k % one.length])
  return geometry.setAttribute('color', new Float32BufferAttribute(colours, one.length))
}

/** The group with its meshes joined into one, those of colours of their own into one each: what a picture costs is mostly how many
 * things it draws. */
function joined(group) {
  group.updateMatrixWorld(true)
  const parts = new Map()
  group.traverse((mesh) => {
    if (!mesh.isMesh) return
    const { material } = mesh
    const geometry = mesh.geometry.clone().applyMatrix4(mesh.matrixWorld).deleteAttribute('uv')
    const own = material.userData.tinted
    const of = own ? material : BAKED
    parts.set(of, [...(parts.get(of) ?? []), own ? geometry : tinted(geometry, material.color)])
  })
  const whole = new Group()
  for (const [material, geometries] of parts) whole.add(shown(new Mesh(mergeGeometries(geometries), material)))
  return whole
}

/** A round bar between two points. */
export function bar(from, to, thick, thin, material) {
  const [a, b] = [new Vector3(...from), new Vector3(...to)]
  const way = b.clone().sub(a)
  const mesh = shown(new Mesh(new CylinderGeometry(thin, thick, way.length(), 7), material))
  // cylinders of three.js stand along y
  mesh.geometry.rotateX(Math.PI / 2)
  mesh.position.copy(a).addScaledVector(way, 0.5)
  mesh.quaternion.setFromUnitVectors(Z, way.normalize())
  return mesh
}

function solid({ geometry, position, rotation }, material) {
  const [[kind, size]] = Object.entries(geometry)
  const make = {
    sphere: () => new SphereGeometry(size.radius, 24, 16),
    capsule: () => new CapsuleGeometry(size.radius, size.length, 6, 14).rotateX(Math.PI / 2),
    box: () => new BoxGeometry(...size.size),
  }
  const mesh = shown(new Mesh(make[kind](), material))
  const [w, x, y, z] = rotation
  mesh.position.set(...position)
  mesh.quaternion.set(x, y, z, w)
  return mesh
}

/** Edges of a load, where its mesh is. */
function edges(mesh) {
  const lines = new LineSegments(new EdgesGeometry(mesh.geometry), EDGE)
  lines.position.copy(mesh.position)
  lines.quaternion.copy(mesh.quaternion)
  return lines
}

/** A blade along x from the hub, for a rotor of radius 1: chord and pitch shrink towards the tip. */
function blade(spin) {
  const places = []
  const faces = []
  const parts = 6
  for (let k = 0; k <= parts; k++) {
    const s = k / parts
    const chord = (0.1 + 0.16 * Math.sin(Math.PI * Math.min(1, 0.2 + s)) * (1 - 0.45 * s))
    const pitch = spin * (0.55 - 0.38 * s)
    for (const side of [-0.5, 0.5]) {
      places.push(0.06 + 0.94 * s, side * chord * Math.cos(pitch), side * chord * Math.sin(pitch))
    }
    if (k > 0) {
      const n = 2 * k
      faces.push(n - 2, n - 1, n, n, n - 1, n + 1)
    }
  }
  const geometry = new BufferGeometry()
  geometry.setAttribute('position', new Float32BufferAttribute(places, 3))
  geometry.setIndex(faces)
  geometry.computeVertexNormals()
  return geometry
}

/** Two blades and the cap above them. */
function blades(spin) {
  const cap = new ConeGeometry(0.08, 0.12, 12).rotateX(Math.PI / 2).translate(0, 0, 0.05).deleteAttribute('uv')
  return mergeGeometries([blade(spin), blade(spin).rotateZ(Math.PI), cap])
}

/** The room that blades sweep: pale, with a rim. */
function disc() {
  const white = new Color('#ffffff')
  const [inside, rim] = [new CircleGeometry(1, 32), new RingGeometry(0.965, 1, 40)]
  return mergeGeometries([tinted(inside, white, 0.2), tinted(rim, white, 0.6)]).translate(0, 0, 0.02)
}

const SWEPT = new MeshBasicMaterial({ vertexColors: true, transparent: true, depthWrite: false, side: DoubleSide })

/** Blades and discs of all rotors of a scene: three things to draw, however many rotors there are. */
export class Propellers {
  /** Of vehicles, whose `root` tells whether they are to be seen. */
  constructor(vehicles) {
    this.rotors = vehicles.flatMap(({ rotors, root }) => rotors.map((own) => Object.assign(own, { root })))
    const many = (geometry, material, own) => Object.assign(new InstancedMesh(geometry, material, own.length), { own, frustumCulled: false })
    const turning = (spin) => this.rotors.filter(({ rotor }) => (rotor.spin >= 0 ? 1 : -1) === spin)
    this.blades = [1, -1].map((spin) => shown(many(blades(spin), BLADE, turning(spin))))
    this.discs = many(disc(), SWEPT, this.rotors)
    this.group = new Group().add(...this.blades, this.discs)
  }

  /** Lays them where their hubs are: after these have moved. */
  lay() {
    const [whole, turn, scale] = [new Matrix4(), new Matrix4(), new Vector3()]
    for (const mesh of [...this.blades, this.discs]) {
      mesh.own.forEach(({ group, rotor, angle, failed, root }, i) => {
        const size = root.visible ? rotor.radius : 0
        whole.multiplyMatrices(group.matrixWorld, turn.makeRotationZ(mesh === this.discs ? 0 : angle))
        mesh.setMatrixAt(i, whole.scale(scale.set(size, size, size)))
        if (mesh === this.discs) mesh.setColorAt(i, failed ? DISC.lost : DISC[rotor.spin >= 0 ? 1 : -1])
      })
      mesh.instanceMatrix.needsUpdate = true
      if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true
    }
  }
}

/** Hub and motor of a rotor; its blades are drawn with all others. */
function propeller(rotor) {
  const group = new Group()
  const { radius } = rotor
  group.position.set(...rotor.position)
  group.quaternion.setFromUnitVectors(Z, new Vector3(...rotor.axis))
  const above = new Vector3(...rotor.position).dot(new Vector3(...rotor.axis)) >= 0 ? 1 : -1
  const height = 0.2 * radius
  const motor = shown(new Mesh(new CylinderGeometry(0.14 * radius, 0.16 * radius, height, 9), METAL))
  motor.geometry.rotateX(Math.PI / 2)
  motor.position.z = -0.5 * above * height
  motor.applyMatrix4(new Matrix4().compose(group.position, group.quaternion, new Vector3(1, 1, 1)))
  return { group, motor, rotor, angle: 0, failed: false }
}

/** Frame of a drone with three rotors and more: plates, canopy, arms, legs; the front is told by its lamp and arms. */
function airframe(body, colour) {
  const group = new Group()
  const hubs = body.rotors.map((r) => new Vector3(...r.position))
  const radius = body.rotors[0].radius
  const reach = Math.max(...hubs.map((h) => Math.hypot(h.x, h.y)))
  const middle = new Vector3(0, 0, hubs.reduce((sum, h) => sum + h.z, 0) / hubs.length - 0.2 * radius)
  const paint = painted(colour)
  for (const hub of hubs) {
    const end = hub.clone().sub(new Vector3(0, 0, 0.16 * radius))
    const front = hub.x > 0.3 * reach
    group.add(bar(middle.toArray(), end.toArray(), 0.055 * reach, 0.035 * reach, front ? paint : CARBON))
  }
  const size = Math.max(0.2 * reach, 0.02)
  const plate = shown(new Mesh(new CylinderGeometry(1.25 * size, 1.25 * size, 0.22 * size, 8), CARBON))
  plate.geometry.rotateX(Math.PI / 2)
  plate.position.copy(middle)
  const canopy = shown(new Mesh(new SphereGeometry(size, 16, 10), paint))
  canopy.scale.set(1.3, 0.95, 0.75)
  canopy.position.copy(middle).z += 0.3 * size
  const battery = shown(new Mesh(new BoxGeometry(1.9 * size, 0.9 * size, 0.55 * size), METAL))
  battery.position.copy(middle).z -= 0.38 * size
  const lamp = new Mesh(new SphereGeometry(0.22 * size, 8, 6), LIGHT)
  lamp.position.copy(middle).add(new Vector3(1.28 * size, 0, 0.3 * size))
  group.add(plate, canopy, battery, lamp)
  for (const [x, y] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) {
    const foot = [1.3 * size * x, 1.15 * size * y, middle.z - 1.5 * size]
    group.add(bar([0.7 * size * x, 0.6 * size * y, middle.z], foot, 0.09 * size, 0.07 * size, CARBON))
  }
  return group
}

/** Where the task or the reference wants somebody: a ball in two rings. */
export function target(colour, radius) {
  const ring = () => new TorusGeometry(1.9 * radius, 0.09 * radius, 6, 32)
  const parts = [new SphereGeometry(0.7 * radius, 14, 10), ring(), ring().rotateX(Math.PI / 2)]
  return new Mesh(mergeGeometries(parts), new MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.88 }))
}

/** Radius of a capsule that is a load, no bar, m. */
const THICK = 0.06

/** Joints at the ends of the bars of a chain or frame. */
function knuckles(body) {
  return body.solids.filter((shape) => shape.geometry.capsule?.radius < THICK).flatMap(({ geometry: { capsule }, position, rotation }) => {
    const [w, x, y, z] = rotation
    return [-0.5, 0.5].map((share) => {
      const joint = shown(new Mesh(new SphereGeometry(2.1 * capsule.radius, 14, 10), CARBON))
      joint.position.set(0, 0, share * capsule.length).applyQuaternion(new Quaternion(x, y, z, w)).add(new Vector3(...position))
      return joint
    })
  })
}

/** Materials of a body's shapes by what it is. */
function materials(body, kind, size, colour) {
  if (body.rotors.length > 0) return painted(colour)
  if (kind === 'box' || (kind === 'capsule' && size.radius > THICK)) return CARDBOARD
  if (kind === 'sphere') return BALL
  return body.beside_rotors ? lambert('#e8edf2') : CARBON
}

/** One vehicle or system: a group with one child per body, and its rotors. */
export class Vehicle {
  constructor(look, colour, { several }) {
    this.group = new Group()
    this.rotors = []
    this.bodies = look.bodies.map((body) => {
      const own = new Group()
      const fixed = new Group()
      const paint = several && body.drone != null ? nth(body.drone) : colour
      const flies = body.rotors.length >= 3
      if (flies) fixed.add(airframe(body, paint))
      for (const shape of body.solids) {
        const [[kind, size]] = Object.entries(shape.geometry)
        // what collides of a drone is inside the frame that is drawn
        if (flies && kind !== 'capsule') continue
        const made = solid(shape, materials(body, kind, size, paint))
        fixed.add(made)
        if (made.material === CARDBOARD && kind === 'box') own.add(edges(made))
      }
      for (const joint of body.beside_rotors ? knuckles(body) : []) fixed.add(joint)
      for (const [from, to] of body.struts) {
        if (!flies) fixed.add(bar(from, to, 0.016, 0.013, CARBON))
      }
      for (const rotor of body.rotors) {
        const made = propeller(rotor)
        this.rotors[rotor.number] = made
        own.add(made.group)
        fixed.add(made.motor)
      }
      own.add(joined(fixed))
      this.group.add(own)
      return own
    })
  }

  /** Blades turn as the rotors do, slowly enough to be seen: 30 rad/s at full speed. */
  turn(rotor, share, seconds) {
    const made = this.rotors[rotor]
    made.angle += made.rotor.spin * share * 30 * seconds
  }

  /** A rotor that failed shows its disc in red. */
  fail(rotor, failed) {
    this.rotors[rotor].failed = failed
  }
}

/** Longest view that is drawn, m. */
const SEEN = 3

/** A sensor: a little box with its axes, and the edges of what it sees along its -z. */
export function sensor({ position, rotation, view }, size) {
  const d = 0.12 * size
  const ends = [[-d, 0, 0, d, 0, 0], [0, -d, 0, 0, d, 0], [0, 0, -d, 0, 0, d]]
  if (view) {
    const reach = Math.min(view.reach, SEEN)
    const wide = Math.tan(Math.min(view.angle, 2.8) / 2) * reach
    const corners = Array.from({ length: view.corners || 16 }, (_, k) => {
      const turn = (2 * Math.PI * (k + (view.corners ? 0.5 : 0))) / (view.corners || 16)
      // a picture is as wide as its sides, not as its corners
      const far = view.corners ? Math.SQRT2 * wide : wide
      return [far * Math.cos(turn), far * Math.sin(turn), -reach]
    })
    corners.forEach((corner, k) => {
      ends.push([...corner, ...corners[(k + 1) % corners.length]])
      if (view.corners || k % 4 === 0) ends.push([0, 0, 0, ...corner])
    })
  }
  const geometry = new BufferGeometry().setAttribute('position', new Float32BufferAttribute(ends.flat(), 3))
  const group = new Group()
  group.add(new LineSegments(geometry, new LineBasicMaterial({ color: '#7b2cbf' })))
  group.add(new Mesh(new BoxGeometry(0.6 * d, 0.6 * d, 0.6 * d), new MeshBasicMaterial({ color: '#7b2cbf' })))
  const [w, x, y, z] = rotation
  group.position.set(...position)
  group.quaternion.set(x, y, z, w)
  return group
}

/** What stands still. */
export function obstacle(shape) {
  return solid(shape, STILL)
}

const SHAFT = new CylinderGeometry(0.012, 0.012, 0.8, 8).rotateX(Math.PI / 2).translate(0, 0, 0.4)
const TIP = new ConeGeometry(0.035, 0.2, 12).rotateX(Math.PI / 2).translate(0, 0, 0.9)

/** An arrow of length 1 along z. */
export function arrow(colour) {
  const material = new MeshBasicMaterial({ color: colour })
  const group = new Group()
  group.add(new Mesh(SHAFT, material), new Mesh(TIP, material))
  group.visible = false
  return group
}

/** Lays an arrow from a point along a way. */
export function point(arrow, from, way, length) {
  arrow.visible = length > 1e-3
  if (!arrow.visible) return
  arrow.position.copy(from)
  arrow.quaternion.copy(new Quaternion().setFromUnitVectors(Z, way.clone().normalize()))
  arrow.scale.set(1, 1, length)
}

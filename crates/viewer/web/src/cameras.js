// Who looks from where: around a point, behind a drone, from on board.
import { Box3, PerspectiveCamera, Quaternion, Vector3 } from 'three'
import { OrbitControls } from 'three/addons/controls/OrbitControls.js'

export const CAMERAS = ['orbit', 'follow', 'on board']
/** A room so many times as large as a flier shows it as a speck. */
const SPECK = 25
/** Amid obstacles: half of the picture's height in sizes of the flier, and the camera's height over its distance. */
const [AMID, LOW] = [2, 0.32]
const [PLACE, TURN, AHEAD] = [new Vector3(), new Quaternion(), new Vector3()]

/** One camera for all flights beside each other: what it does in one, it does in the other. */
export class Cameras {
  constructor(stages, element) {
    this.stages = stages
    this.element = element
    this.camera = new PerspectiveCamera(42, 1, 0.01, 200)
    this.camera.up.set(0, 0, 1)
    this.controls = new OrbitControls(this.camera, element)
    Object.assign(this.controls, { enableDamping: true, dampingFactor: 0.12, maxDistance: 60, minDistance: 0.08 })
    this.board = new PerspectiveCamera(95, 1, 0.005, 200)
    this.board.up.set(0, 0, 1)
    this.drone = 0
    this.mode = 'orbit'
    this.last = stages.map(() => new Vector3())
    this.home()
  }

  /** So that all that matters is in the picture; one alone is followed from near, and so is the first of several that are specks in
   * the room that they take. Where things stand, the camera looks past the drone at them, across the ground. */
  home() {
    const [stage] = this.stages
    const room = this.stages.reduce((all, s) => all.union(s.room), new Box3())
    const look = Math.max(...this.stages.map((s) => s.look))
    const whole = 0.5 * room.getSize(PLACE).length()
    const scene = this.stages.some((s) => s.obstacles.length > 0)
    const follow = this.stages.every((s) => s.players.length === 1) || (scene && whole > SPECK * look)
    const focus = follow ? this.center(stage, new Vector3()) : room.getCenter(new Vector3())
    const ahead = stage.beset(focus)
    const radius = follow ? (ahead ? AMID : 1.05) * look : Math.max(1.15 * whole, 1.3 * look)
    const { clientWidth, clientHeight } = this.element
    const aspect = clientWidth / this.stages.length / clientHeight || 1
    const half = Math.atan(Math.tan((0.5 * this.camera.fov * Math.PI) / 180) * Math.min(1, aspect))
    const distance = Math.max(radius, 0.05) / Math.sin(half)
    this.controls.maxDistance = Math.max(60, 1.5 * distance)
    this.camera.far = Math.max(200, 4 * this.controls.maxDistance)
    this.camera.updateProjectionMatrix()
    this.controls.target.copy(focus)
    const from = ahead ? PLACE.copy(ahead).negate().setZ(LOW) : PLACE.set(0.5, -0.75, 0.62)
    this.camera.position.copy(focus).add(from.normalize().multiplyScalar(distance))
    this.choose(follow ? 'follow' : 'orbit')
    this.controls.update()
  }

  /** Middle of the drones of the player that is followed. */
  center(stage, to) {
    const [player] = stage.drones[this.drone % stage.drones.length]
    if (stage.players.length > 1) {
      stage.place(this.drone, to)
      return to
    }
    to.set(0, 0, 0)
    const bodies = player.vehicle.bodies
    for (const body of bodies) to.add(body.getWorldPosition(PLACE))
    return to.divideScalar(bodies.length)
  }

  choose(mode) {
    this.mode = mode
    this.controls.enabled = mode !== 'on board'
    this.stages.forEach((stage, i) => this.center(stage, this.last[i]))
  }

  next() {
    this.drone = (this.drone + 1) % Math.max(...this.stages.map((s) => s.drones.length))
    const at = this.center(this.stages[0], new Vector3())
    this.camera.position.add(at).sub(this.controls.target)
    this.controls.target.copy(at)
    this.choose(this.mode === 'orbit' ? 'follow' : this.mode)
  }

  /** Moves with what is followed. */
  update() {
    if (this.mode === 'follow') {
      const now = this.center(this.stages[0], new Vector3())
      const moved = AHEAD.copy(now).sub(this.last[0])
      this.controls.target.add(moved)
      this.camera.position.add(moved)
      this.last[0].copy(now)
    }
    const turned = this.controls.update()
    const distance = this.camera.position.distanceTo(this.controls.target)
    for (const stage of this.stages) stage.haze(distance)
    return turned
  }

  /** The camera of a flight, of this shape. */
  of(i, aspect) {
    const stage = this.stages[i]
    if (this.mode === 'on board') {
      stage.place(this.drone, PLACE, TURN)
      const size = stage.reach(this.drone)
      this.board.position.copy(PLACE).add(AHEAD.set(0.3 * size, 0, 0.42 * size).applyQuaternion(TURN))
      this.board.up.set(0, 0, 1).applyQuaternion(TURN)
      this.board.lookAt(AHEAD.set(1, 0, -0.22).applyQuaternion(TURN).add(this.board.position))
      return this.shaped(this.board, aspect)
    }
    const camera = this.shaped(this.camera, aspect)
    if (this.mode === 'follow' && i > 0) {
      const other = camera.clone()
      const apart = this.center(stage, new Vector3()).sub(this.center(this.stages[0], AHEAD.clone()))
      other.position.add(apart)
      other.updateMatrixWorld()
      return other
    }
    return camera
  }

  shaped(camera, aspect) {
    if (camera.aspect !== aspect) {
      camera.aspect = aspect
      camera.updateProjectionMatrix()
    }
    return camera
  }
}

// Flights as tables of whole numbers: what the Rust side packs (`pack.rs`, `recording.rs`) is unpacked here.

/** Numbers of bytes that hold seven bits each, the lowest first, their sign in the lowest bit. */
function* whole(bytes) {
  let value = 0
  let place = 1
  for (const byte of bytes) {
    value += (byte & 127) * place
    if (byte & 128) {
      place *= 128
    } else {
      yield value % 2 ? -(value + 1) / 2 : value / 2
      value = 0
      place = 1
    }
  }
}

/** Columns from base64: of each its kind, then one value for all frames, or second differences. */
function unpack(text, width, frames) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0))
  const numbers = whole(bytes)
  const next = () => numbers.next().value ?? 0
  return Array.from({ length: width }, () => {
    const column = new Int32Array(frames)
    if (next() === 0) return column.fill(next())
    let value = 0
    let slope = 0
    for (let k = 0; k < frames; k++) {
      slope += next()
      value += slope
      column[k] = value
    }
    return column
  })
}

/** Numbers of an actor's row in their order: `recording.rs` writes the same. */
function layout(actor, look, from) {
  const bodies = look.bodies.length
  const at = { pose: from }
  at.speed = at.pose + 7 * bodies
  at.goal = at.speed + look.rotors
  at.force = at.goal + 3 * actor.goals
  at.error = at.force + (actor.contact ? 3 * bodies : 0)
  at.end = at.error + (actor.error ? 1 : 0)
  return at
}

/** A flight that can be asked for any time. */
export class Flight {
  constructor(recording) {
    Object.assign(this, recording)
    let width = 0
    for (const actor of this.actors) {
      actor.look = this.looks[actor.look]
      actor.at = layout(actor, actor.look, width)
      width = actor.at.end
    }
    this.columns = unpack(recording.data, width, this.frames)
    this.data = undefined
  }

  get duration() {
    return Math.max(0, this.frames - 1) * this.interval
  }

  /** Takes in one more frame of a flight that goes on. */
  push(row) {
    if (row.length !== this.columns.length) return
    if (this.columns[0].length === this.frames) {
      this.columns = this.columns.map((old) => {
        const longer = new Int32Array(2 * this.frames + 64)
        longer.set(old)
        return longer
      })
    }
    row.forEach((value, k) => (this.columns[k][this.frames] = value))
    this.frames += 1
  }

  /** A column's number at a frame between two others, in its unit. */
  value(column, frame, step) {
    const numbers = this.columns[column]
    const k = Math.min(Math.floor(frame), this.frames - 1)
    const next = Math.min(k + 1, this.frames - 1)
    const share = frame - k
    return step * (numbers[k] + share * (numbers[next] - numbers[k]))
  }

  vector(column, frame, step, to) {
    return to.set(
      this.value(column, frame, step),
      this.value(column + 1, frame, step),
      this.value(column + 2, frame, step),
    )
  }

  /** Last frame of an actor that moves: one that ended early stands. */
  last(actor) {
    return actor.ended ? Math.min(actor.ended.frame, this.frames - 1) : this.frames - 1
  }

  frame(time) {
    return Math.min(Math.max(time / this.interval, 0), Math.max(0, this.frames - 1))
  }

  pose(actor, body, frame, position, attitude) {
    const at = actor.at.pose + 7 * body
    this.vector(at, frame, this.steps.position, position)
    const [w, x, y, z] = [3, 4, 5, 6].map((k) => this.value(at + k, frame, this.steps.attitude))
    attitude.set(x, y, z, w).normalize()
  }

  /** Speed of a rotor as a share of its largest. */
  speed(actor, rotor, frame) {
    return this.value(actor.at.speed + rotor, frame, this.steps.speed)
  }

  goal(actor, goal, frame, to) {
    return this.vector(actor.at.goal + 3 * goal, frame, this.steps.position, to)
  }

  force(actor, body, frame, to) {
    return this.vector(actor.at.force + 3 * body, frame, this.steps.force, to)
  }

  error(actor, frame) {
    return this.value(actor.at.error, frame, this.steps.error)
  }

  /** Thrust of all rotors of an actor together, N. */
  thrust(actor, frame) {
    let sum = 0
    for (const body of actor.look.bodies) {
      for (const rotor of body.rotors) sum += rotor.max_thrust * this.speed(actor, rotor.number, frame) ** 2
    }
    return sum
  }
}

//! Recordings of closed-loop flights and of falls.

use super::look::Look;
use super::recording::{Actor, BETWEEN, Ended, Event, MAX_FRAMES, Measure, Moment, Mount, Recording, View};
use omnidrones::controllers::{Flight, FlightPlan};
use omnidrones::dynamics::Plant;
use omnidrones::dynamics::sensors::{SensorConfig, SensorModel};

/// A flight along its reference: the reference is the target, rotors that fail are told.
pub fn flight(plant: &Plant, flight: &Flight, plan: &FlightPlan) -> Recording {
    let mut recording = record(plant, flight, true);
    let rotors = plant.rotors();
    for failure in &plan.failures {
        let Some(rotor) = rotors.get(failure.rotor) else { continue };
        let left = match failure.effectiveness {
            e if e > 0.0 => format!("keeps {:.0} % of its thrust", 100.0 * e),
            _ => "is lost".into(),
        };
        let text = format!("{} {left} at {} s", rotor.name, failure.at);
        recording.events.push(Event { time: failure.at, text, actor: 0, rotor: Some(failure.rotor) });
    }
    recording.actors[0].mounts = plan.sensors.iter().filter_map(|s| mount(s, &recording.looks[0], plant)).collect();
    let last = recording.n_frame().saturating_sub(1);
    if let Some(at) = flight.diverged_at {
        recording.actors[0].ended = Some(Ended { frame: last, why: format!("diverged at {at:.3} s") });
        recording.events.push(Event { time: at, text: "the flight diverged".into(), actor: 0, rotor: None });
    } else if let Some((at, far)) = flight.lost() {
        let text = format!("lost: {far:.1} m from its reference in the end");
        recording.events.push(Event { time: at, text, actor: 0, rotor: None });
    }
    recording.remark = format!("{}, {} s", plan.reference.name(), plan.duration);
    recording
}

/// A sensor on the body that carries it, where that is to be seen.
fn mount(sensor: &SensorConfig, look: &Look, plant: &Plant) -> Option<Mount> {
    let first = plant.body_names().into_iter().next();
    let on = sensor.on.clone().or(first)?;
    // a vehicle alone is one body
    let body = look.bodies.iter().position(|body| body.name == on).or((look.n_body() == 1).then_some(0))?;
    let view = match &sensor.model {
        SensorModel::Range(range) => Some(View { angle: range.cone, corners: 0, reach: range.farthest }),
        SensorModel::Flow(flow) => Some(View { angle: flow.aperture, corners: 4, reach: flow.farthest }),
        _ => None,
    };
    Some(Mount { name: sensor.name.clone(), body, position: sensor.position, rotation: sensor.rotation, view })
}

/// A fall: nobody steers, nothing is wanted.
pub fn fall(plant: &Plant, flight: &Flight) -> Recording {
    record(plant, flight, false)
}

fn record(plant: &Plant, flight: &Flight, steered: bool) -> Recording {
    let (log, look) = (&flight.log, Look::of(plant));
    let sample = match log.time[..] {
        [first, second, ..] => second - first,
        _ => BETWEEN,
    };
    let stride = ((BETWEEN / sample).round() as usize).max(log.len().div_ceil(MAX_FRAMES)).max(1);
    let actor = Actor {
        name: plant.name().into(),
        look: 0,
        offset: [0.0; 3],
        still: still(plant),
        goals: usize::from(steered),
        contact: plant.tree().is_some() && plant.physics().effects.contact,
        error: steered.then(|| Measure { name: "distance to the reference".into(), unit: "m".into() }),
        weight: look.weight,
        mounts: Vec::new(),
        ended: None,
    };
    let errors = log.error_norm();
    let n = (flight.states.len() / errors.len().max(1)).max(1);
    let mut recording = Recording::new(plant.name(), stride as f64 * sample, vec![look], vec![actor]);
    for (k, state) in flight.states.chunks_exact(n).enumerate().step_by(stride) {
        let moment = Moment {
            poses: recording.looks[0].poses(plant, state),
            speeds: speeds(plant, state),
            goals: if steered { vec![log.reference_position[k]] } else { Vec::new() },
            forces: recording.looks[0].forces(plant, state),
            error: errors[k],
        };
        recording.push(&[moment]);
    }
    recording
}

/// Ω/Ω_max of every rotor in a state.
pub(crate) fn speeds(plant: &Plant, state: &[f64]) -> Vec<f64> {
    plant.rotor_places().iter().map(|r| state[r.speed] / r.max_speed).collect()
}

/// Where a plant's still shapes stand by themselves.
fn still(plant: &Plant) -> Vec<[f64; 3]> {
    let shapes = plant.tree().into_iter().flat_map(|system| system.model().shapes());
    shapes.filter(|s| s.body.is_none()).map(|s| s.shape.position).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use omnidrones::controllers::{FlightPlan, fly_vehicle};
    use omnidrones::dynamics::{Physics, vehicles};

    #[test]
    fn a_sensor_sits_where_its_settings_say_and_sees_what_they_say() {
        let vehicle = vehicles::by_name("crazyflie").unwrap();
        let plant = Plant::of_vehicle(&vehicle, Physics::default()).unwrap();
        let mut sensors = SensorConfig::parse_list("range:vl53l1x,flow:pmw3901,imu").unwrap();
        sensors[0].position = [0.0, 0.01, -0.02];
        let plan = FlightPlan { duration: 0.1, sensors, ..FlightPlan::default() };
        let flown = fly_vehicle(&vehicle, &vehicle.gains(), &plan, &mut |_| {}).unwrap();
        let recording = flight(&plant, &flown, &plan);
        let [range, flow, imu] = &recording.actors[0].mounts[..] else { panic!("{:?}", recording.actors[0].mounts) };
        assert_eq!((range.position, range.body), ([0.0, 0.01, -0.02], 0));
        let view = range.view.unwrap();
        // 27° and 4 m, as its data sheet says
        assert!(view.corners == 0 && (view.angle.to_degrees() - 27.0).abs() < 0.1 && view.reach == 4.0, "{view:?}");
        assert!(flow.view.is_some_and(|view| view.corners == 4) && imu.view.is_none());
        assert!(recording.to_json()["actors"][0]["mounts"][0]["view"]["reach"] == 4.0);
    }
}

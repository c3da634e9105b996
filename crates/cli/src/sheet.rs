//! A vehicle's numbers as facts, tables and JSON.

use crate::prelude::*;
use nalgebra::DMatrix;
use omnidrones::controllers::Mixer;
use omnidrones::dynamics::rotor::ROTOR_PARAMETERS;
use omnidrones::dynamics::spatial::to_euler;
use omnidrones::dynamics::{GRAVITY, Gains, HoverTrim, Rotor, Vehicle};

/// What characterises a vehicle; `None` where it cannot hover.
pub struct KeyFigures {
    pub mass: f64,
    pub thrust_to_weight: f64,
    /// Mean thrust of the rotors in hover over their largest, 0 to 1.
    pub hover_thrust: Option<f64>,
    /// The hover, or why there is none.
    pub hover: Result<HoverTrim>,
    /// Slowest time constants of the motors, up and down, s.
    pub time_constants: [f64; 2],
    /// 1/(4τ), rad/s.
    pub bandwidth_limit: f64,
}

impl KeyFigures {
    pub fn of(vehicle: &Vehicle) -> Self {
        let slowest = |of: fn(&Rotor) -> f64| vehicle.rotors.iter().map(of).fold(0.0, f64::max);
        let hover = vehicle.hover();
        let share = |thrusts: &[f64]| {
            let shares = thrusts.iter().zip(&vehicle.rotors).map(|(t, r)| t / r.max_thrust());
            shares.sum::<f64>() / vehicle.n_rotor() as f64
        };
        Self {
            mass: vehicle.mass_properties().mass,
            thrust_to_weight: vehicle.thrust_to_weight(),
            hover_thrust: hover.as_ref().ok().map(|hover| share(&hover.thrusts)),
            hover,
            time_constants: [slowest(|r| r.time_constant_up), slowest(|r| r.time_constant_down)],
            bandwidth_limit: vehicle.bandwidth_limit(),
        }
    }

    /// The rotor action in [−1, 1] that hovers.
    pub fn hover_command(&self) -> Option<f64> {
        self.hover_thrust.map(|t| 2.0 * t - 1.0)
    }

    /// `12.5 / 25`, or one number where both ways are equal; ms.
    pub fn motor(&self) -> String {
        let [up, down] = self.time_constants.map(|t| short(1e3 * t, 3));
        if up == down { up } else { format!("{up} / {down}") }
    }

    pub fn json(&self, vehicle: &Vehicle) -> Value {
        json!({
            "name": vehicle.name,
            "source": vehicle.source,
            "rotors": vehicle.n_rotor(),
            "mass": self.mass,
            "thrust_to_weight": self.thrust_to_weight,
            "max_thrust": vehicle.max_thrust(),
            "lift_to_weight": vehicle.balanced_lift().ok(),
            "hover_thrust": self.hover_thrust,
            "hover_command": self.hover_command(),
            "hover_lean": self.hover.as_ref().ok().map(HoverTrim::lean),
            "hover_reserve": self.hover.as_ref().ok().map(|hover| hover.reserve),
            "motor_time_constant_up": self.time_constants[0],
            "motor_time_constant_down": self.time_constants[1],
            "bandwidth_limit": self.bandwidth_limit,
        })
    }
}

/// Mass, rotors, thrust, hover, motors.
pub fn key_facts(vehicle: &Vehicle) -> Vec<Fact> {
    let key = KeyFigures::of(vehicle);
    let weight = key.mass * GRAVITY;
    let motor =
        if key.time_constants[0] == key.time_constants[1] { "time constant" } else { "time constant up / down" };
    let mut facts = vec![
        Fact::new("mass", format!("{} kg", short(key.mass, 4))).note(format!("weight {} N", short(weight, 4))),
        Fact::new("rotors", vehicle.n_rotor().to_string())
            .note(format!("{} N together at full speed", short(vehicle.max_thrust(), 4))),
        Fact::new("thrust / weight", number(key.thrust_to_weight, 2)),
    ];
    // where it is not what all rotors push together
    let lift = vehicle.balanced_lift().ok().filter(|lift| *lift < 0.95 * key.thrust_to_weight);
    facts.extend(lift.map(|lift| Fact::new("lift / weight", number(lift, 2)).note("without a moment")));
    facts.extend(hover_facts(&key, vehicle));
    facts.push(
        Fact::new("motor lag", format!("{} ms", key.motor()))
            .note(format!("{motor}; carries an attitude loop of {} rad/s", short(key.bandwidth_limit, 3))),
    );
    facts
}

/// Thrust, lean and least reserve of hover, or the row that cannot be met.
fn hover_facts(key: &KeyFigures, vehicle: &Vehicle) -> Vec<Fact> {
    let hover = match &key.hover {
        Ok(hover) => hover,
        Err(Error::Value { value, .. }) => return vec![Fact::new("hover", "impossible").note(value)],
        Err(error) => return vec![Fact::new("hover", "impossible").note(error.to_string())],
    };
    let (share, command) = (key.hover_thrust.unwrap_or(0.0), key.hover_command().unwrap_or(-1.0));
    let tightest = &vehicle.rotors[hover.tightest].name;
    let mut facts = vec![
        Fact::new("hover", format!("{} %", number(100.0 * share, 1)))
            .note(format!("of full thrust, rotor command {command:+.3}")),
        Fact::new("least reserve", format!("{} %", number(100.0 * hover.reserve, 1)))
            .note(format!("of full thrust, to either limit: rotor '{tightest}'")),
    ];
    if !hover.is_level() {
        let [roll, pitch, _] = to_euler(hover.attitude).map(f64::to_degrees);
        let angles = format!("roll {}°, pitch {}°", short(roll, 3), short(pitch, 3));
        facts.push(Fact::new("leans in hover", format!("{}°", short(hover.lean().to_degrees(), 3))).note(angles));
    }
    facts
}

/// Centre of mass, inertia, drag, authority, gains, then parts, rotors and allocation as tables.
pub fn sheet(page: &mut Page, vehicle: &Vehicle) -> Result<()> {
    let total = vehicle.mass_properties();
    let j = total.inertia;
    let authority = vehicle.authority();
    let drag = &vehicle.drag;
    let mut facts = key_facts(vehicle);
    facts.push(Fact::new("centre of mass", vector(total.center_of_mass.as_slice(), 3)).note("m, in the base frame"));
    facts.push(Fact::new("inertia J", vector(&[j[(0, 0)], j[(1, 1)], j[(2, 2)]], 4)).note("kg m², xx yy zz about it"));
    let products = [j[(0, 1)], j[(0, 2)], j[(1, 2)]];
    if products.iter().any(|p| p.abs() > 1e-6 * j.trace()) {
        facts.push(Fact::new("", vector(&products, 4)).note("kg m², xy xz yz"));
    }
    for (name, values, unit) in [
        ("linear drag", drag.linear, "N s/m, body axes"),
        ("quadratic drag", drag.quadratic, "N s²/m², body axes"),
        ("angular drag", drag.angular, "N m s, body axes"),
    ] {
        if values != [0.0; 3] {
            facts.push(Fact::new(name, vector(&values, 3)).note(unit));
        }
    }
    let control = match authority.dropped.as_slice() {
        [] if authority.full_rank == 6 => "thrust, roll, pitch, yaw and sideways force".to_string(),
        [] => "thrust, roll, pitch, yaw".into(),
        _ => authority.shortcomings(),
    };
    facts.push(Fact::new("steered axes", control).note(format!("allocation of rank {}", authority.full_rank)));
    page.facts(facts);
    page.heading("Parts").table(parts(vehicle));
    rotors(page, vehicle);
    page.heading("Allocation matrix").table(allocation(vehicle));
    page.line("  wrench about the centre of mass, base axes, per newton of each rotor's thrust");
    Ok(())
}

/// `(0, 0, 0.01)`.
pub fn vector(values: &[f64], digits: usize) -> String {
    // centres of mass are sums: what is left of a cancellation is zero
    let largest = values.iter().fold(0.0, |a: f64, v| a.max(v.abs()));
    let clean = |v: &f64| if v.abs() < 1e-12 * largest.max(1e-3) { 0.0 } else { *v };
    let texts: Vec<String> = values.iter().map(|v| short(clean(v), digits)).collect();
    format!("({})", texts.join(", "))
}

/// Parts with mass, place and inertia; equal rows stay apart, since names matter.
pub fn parts(vehicle: &Vehicle) -> Table {
    Table::new("part | >mass [kg] | centre of mass [m] | inertia xx yy zz [kg m²]").filled(vehicle.parts.iter().map(
        |part| {
            let i = &part.inertia;
            [part.name.clone(), short(part.mass, 4), vector(&part.position, 3), vector(&[i.xx, i.yy, i.zz], 3)]
        },
    ))
}

/// A size of a rotor: symbol, what it is, unit, scale to that unit, value.
type RotorColumn = (&'static str, &'static str, &'static str, f64, fn(&Rotor) -> f64);

/// The sizes among a rotor's parameters, times in milliseconds, then what follows from them or is geometry.
fn rotor_columns() -> Vec<RotorColumn> {
    let sizes = ROTOR_PARAMETERS.iter().filter(|p| p.domain.keeps_sign()).map(|p| {
        let (unit, scale) = if p.unit == "s" { ("ms", 1e3) } else { (p.unit, 1.0) };
        (p.symbol, p.meaning, unit, scale, p.get)
    });
    let others: [RotorColumn; 2] = [
        ("T_max", "largest thrust", "N", 1.0, Rotor::max_thrust),
        ("radius", "hub to blade tip", "m", 1.0, |r| r.radius),
    ];
    sizes.chain(others).collect()
}

/// Where each rotor is and how it turns, with whatever differs between rotors; then what all have in common.
pub fn rotors(page: &mut Page, vehicle: &Vehicle) {
    let rotors = &vehicle.rotors;
    let upright = rotors.iter().all(|r| r.axis == [0.0, 0.0, 1.0]);
    let (common, own): (Vec<RotorColumn>, Vec<RotorColumn>) =
        rotor_columns().into_iter().partition(|(.., of)| rotors.windows(2).all(|pair| of(&pair[0]) == of(&pair[1])));
    let own_headers = own.iter().map(|(symbol, _, unit, ..)| format!("{symbol} [{unit}]"));
    let headers = if upright { "rotor | hub [m] | spin" } else { "rotor | hub [m] | axis | spin" };
    let mut table = Table::new(headers).with(Align::Right, own_headers);
    for rotor in rotors {
        let mut row = vec![rotor.name.clone(), vector(&rotor.position, 3)];
        if !upright {
            row.push(vector(&rotor.axis, 3));
        }
        row.push(if rotor.spin > 0.0 { "counter-clockwise".into() } else { "clockwise".into() });
        row.extend(own.iter().map(|(.., scale, of)| short(scale * of(rotor), 4)));
        table.row(row);
    }
    page.heading("Rotors").table(table);
    page.line(if upright {
        "  axes along body z; spins seen from above"
    } else {
        "  spins seen from the tip of the axis"
    });
    let Some(first) = rotors.first() else { return };
    let facts: Vec<Fact> = common
        .iter()
        .map(|(symbol, what, unit, scale, of)| (symbol, what, unit, scale * of(first)))
        .filter(|(.., value)| *value != 0.0)
        .map(|(symbol, what, unit, value)| Fact::new(*symbol, format!("{} {unit}", short(value, 4))).note(*what))
        .collect();
    if !facts.is_empty() {
        page.heading("Every rotor").facts(facts);
    }
}

fn allocation(vehicle: &Vehicle) -> Table {
    let matrix = vehicle.allocation_matrix();
    let n = matrix.ncols();
    let mut table = Table::new("per N of").with(Align::Right, vehicle.rotors.iter().map(|r| &r.name));
    for (row, name) in ["F_x", "F_y", "F_z", "M_x [m]", "M_y [m]", "M_z [m]"].iter().enumerate() {
        let tidy = |v: f64| if v.abs() < 5e-7 { "0".to_string() } else { short((1e6 * v).round() / 1e6, 4) };
        let cells = (0..n).map(|i| tidy(matrix[(row, i)]));
        table.row(std::iter::once(name.to_string()).chain(cells));
    }
    table
}

/// A number per axis, from a vehicle and its gains.
type PerAxis = fn(&Vehicle, &Gains) -> [f64; 3];

/// Gains side by side, with the bandwidth and damping that they give without motor lag.
pub fn gains_table(vehicle: &Vehicle, sets: &[(&str, Gains)]) -> Table {
    let mut table = Table::new("per axis x, y, z").with(Align::Left, sets.iter().map(|(name, _)| *name));
    let rows: [(&str, PerAxis); 9] = [
        ("position K_p [1/s²]", |_, g| g.position),
        ("velocity K_v [1/s]", |_, g| g.velocity),
        ("attitude K_R [N m/rad]", |_, g| g.attitude),
        ("rate K_ω [N m s/rad]", |_, g| g.rate),
        ("integral L of force, moment [1/s]", |_, g| [g.integral[0], g.integral[1], f64::NAN]),
        ("position bandwidth [rad/s]", |_, g| g.position.map(f64::sqrt)),
        ("position damping", |_, g| [0, 1, 2].map(|i| 0.5 * g.velocity[i] / g.position[i].sqrt())),
        ("attitude bandwidth [rad/s]", |v, g| attitude_bandwidth(v, g)),
        ("attitude damping", |v, g| {
            let w = attitude_bandwidth(v, g);
            [0, 1, 2].map(|i| 0.5 * g.rate[i] * w[i] / g.attitude[i])
        }),
    ];
    for (name, of) in rows {
        let cells = sets.iter().map(|(_, gains)| {
            let values = of(vehicle, gains);
            let given = if values[2].is_nan() { &values[..2] } else { &values[..] };
            if given.iter().all(|v| *v == given[0]) { short(given[0], 4) } else { vector(given, 3) }
        });
        table.row(std::iter::once(name.to_string()).chain(cells));
    }
    table
}

fn attitude_bandwidth(vehicle: &Vehicle, gains: &Gains) -> [f64; 3] {
    let inertia = vehicle.mass_properties().inertia;
    [0, 1, 2].map(|i| (gains.attitude[i] / inertia[(i, i)]).sqrt())
}

/// Everything about a vehicle for JSON.
pub fn json(vehicle: &Vehicle) -> Result<Value> {
    let total = vehicle.mass_properties();
    let rows = |m: &DMatrix<f64>| -> Vec<Vec<f64>> { m.row_iter().map(|r| r.iter().copied().collect()).collect() };
    let inertia: Vec<Vec<f64>> = total.inertia.row_iter().map(|r| r.iter().copied().collect()).collect();
    let upright = &vehicle.upright();
    let mixer = Mixer::new(upright)?.carrying(upright);
    let mut value = KeyFigures::of(vehicle).json(vehicle);
    value["center_of_mass"] = json!(total.center_of_mass.as_slice());
    value["inertia"] = json!(inertia);
    value["parts"] = json!(vehicle.parts);
    value["rotor_table"] = json!(vehicle.rotors);
    value["drag"] = json!(vehicle.drag);
    value["allocation_matrix"] = json!(rows(&vehicle.allocation_matrix()));
    value["mixer"] = json!(mixer.rows);
    value["allocation_rank"] = json!(mixer.authority.full_rank);
    value["gains"] = json!(vehicle.gains());
    value["derived_gains"] = json!(vehicle.derived_gains());
    value["published_gains"] = json!(vehicle.published_gains);
    Ok(value)
}

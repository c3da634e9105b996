//! One rigid part before it is joined: shapes with a mass or density, a vehicle, or given mass properties.

use super::placement::clean;
use crate::shape::{Geometry, Shape};
use crate::vehicle::{Drag, Inertia, MassProperties, Rotor, Vehicle};
use base::error::{Error, Result, finite};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// A rigid part in its own frame.
///
/// Its mass comes from its shapes by a density, or is given and spread over them by volume (shapes that overlap count
/// twice), or is given with centre and inertia.
#[derive(Debug, Clone, PartialEq)]
pub struct Solid {
    weight: Weight,
    shapes: Vec<Shape>,
    collides: bool,
    rotors: Vec<Rotor>,
    is_vehicle: bool,
    drag: Drag,
    damping: [f64; 2],
}

/// Where the mass comes from.
#[derive(Debug, Clone, PartialEq)]
enum Weight {
    /// kg/m³.
    Density(f64),
    /// kg, spread over the shapes by volume.
    Given(f64),
    /// All of it given.
    Explicit(MassProperties),
}

impl Solid {
    /// A ball about the origin, `radius` in m. Like all solids of shapes, without mass until [`Solid::mass`] or [`Solid::density`] is
    /// called.
    pub fn sphere(radius: f64) -> Self {
        Self::of([Shape { geometry: Geometry::Sphere { radius }, ..ORIGIN }])
    }

    /// A capsule about the origin along z; `length` is that of its cylindrical part, both in m.
    pub fn capsule(radius: f64, length: f64) -> Self {
        Self::of([Shape { geometry: Geometry::Capsule { radius, length }, ..ORIGIN }])
    }

    /// A box about the origin, edges along the axes, full lengths in m.
    pub fn cuboid(size: [f64; 3]) -> Self {
        Self::of([Shape { geometry: Geometry::Box { size }, ..ORIGIN }])
    }

    /// A round bar between two points of the part's frame: a capsule whose half balls are centred on them, m.
    pub fn bar(from: [f64; 3], to: [f64; 3], radius: f64) -> Self {
        Self::of([rod(from, to, radius)])
    }

    /// Several shapes as one part.
    pub fn of(shapes: impl IntoIterator<Item = Shape>) -> Self {
        Self::with(Weight::Given(0.0), shapes.into_iter().collect())
    }

    /// Mass in kg, centre of mass in m and inertia about it, part axes; no shape yet.
    pub fn explicit(mass: f64, center_of_mass: [f64; 3], inertia: Inertia) -> Self {
        let center_of_mass = Vector3::from(center_of_mass);
        Self::with(Weight::Explicit(MassProperties { mass, center_of_mass, inertia: inertia.matrix() }), Vec::new())
    }

    /// A whole vehicle as one part: its mass, rotors, drag and shapes in its base frame. Rotors get the part's name before
    /// their own (`drone/rotor_0`), and the part is a [`Drone`](crate::tree::Drone) centred on its origin.
    pub fn vehicle(vehicle: &Vehicle) -> Self {
        Self {
            rotors: vehicle.rotors.clone(),
            is_vehicle: true,
            drag: vehicle.drag,
            ..Self::with(Weight::Explicit(vehicle.mass_properties()), vehicle.shapes.clone())
        }
    }

    fn with(weight: Weight, shapes: Vec<Shape>) -> Self {
        let (rotors, drag) = (Vec::new(), Drag::default());
        Self { weight, shapes, collides: true, rotors, is_vehicle: false, drag, damping: [0.0; 2] }
    }

    /// One more shape, which shares in a mass that is spread by volume.
    #[must_use]
    pub fn and(mut self, shape: Shape) -> Self {
        self.shapes.push(shape);
        self
    }

    /// All shapes moved by `offset`, m.
    #[must_use]
    pub fn at(mut self, offset: [f64; 3]) -> Self {
        for shape in &mut self.shapes {
            shape.position = std::array::from_fn(|k| shape.position[k] + offset[k]);
        }
        self
    }

    /// The given mass, kg; centre of mass stays, inertia follows in proportion.
    #[must_use]
    pub fn mass(mut self, mass: f64) -> Self {
        self.weight = match self.weight {
            Weight::Explicit(own) => {
                let inertia = if own.mass > 0.0 { own.inertia * (mass / own.mass) } else { own.inertia };
                Weight::Explicit(MassProperties { mass, inertia, ..own })
            }
            _ => Weight::Given(mass),
        };
        self
    }

    /// Mass from the volume of the shapes; kg/m³.
    #[must_use]
    pub fn density(mut self, density: f64) -> Self {
        self.weight = Weight::Density(density);
        self
    }

    /// A rotor in the part's frame, under the name it has.
    #[must_use]
    pub fn rotor(mut self, rotor: Rotor) -> Self {
        self.rotors.push(rotor);
        self
    }

    /// Drag along the part's axes, acting at the centre of mass of the body that the part ends in.
    #[must_use]
    pub fn drag(mut self, drag: Drag) -> Self {
        self.drag = drag;
        self
    }

    /// Drag that slows the part at given rates (1/s) whatever its mass: F = −linear m v, M = −angular J ω with the
    /// diagonal of its J. PhysX calls this linear and angular damping.
    #[must_use]
    pub fn damping(mut self, linear: f64, angular: f64) -> Self {
        self.damping = [linear, angular];
        self
    }

    /// Shapes are drawn and weighed, but touch nothing.
    #[must_use]
    pub fn without_collision(mut self) -> Self {
        self.collides = false;
        self
    }

    /// Lengths times `factor`. A mass from a density grows with its cube and the inertia with the fifth power; a given
    /// mass stays, and the inertia grows with the square. Coefficients of rotors and drag stay as they are.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        if let Weight::Explicit(own) = &mut self.weight {
            own.center_of_mass *= factor;
            own.inertia *= factor * factor;
        }
        for shape in &mut self.shapes {
            *shape = shape.scaled(factor);
        }
        for rotor in &mut self.rotors {
            rotor.position = rotor.position.map(|x| factor * x);
            rotor.radius *= factor;
        }
        self
    }

    /// Mass (kg), centre of mass (m) and inertia about it (kg m²), in the part's frame.
    pub fn properties(&self) -> MassProperties {
        let density = match &self.weight {
            Weight::Explicit(own) => return *own,
            Weight::Density(density) => *density,
            Weight::Given(mass) => mass / self.shapes.iter().map(Shape::volume).sum::<f64>(),
        };
        combined(self.shapes.iter().map(|shape| {
            let mass = shape.mass(density);
            let inertia = shape.inertia(mass).matrix();
            MassProperties { mass, center_of_mass: shape.position.into(), inertia }
        }))
    }

    /// Drag along the part's axes, that from [`Solid::damping`] included.
    pub(crate) fn total_drag(&self) -> Drag {
        let own = self.properties();
        let [linear, angular] = self.damping;
        Drag {
            linear: self.drag.linear.map(|d| d + linear * own.mass),
            quadratic: self.drag.quadratic,
            angular: std::array::from_fn(|k| self.drag.angular[k] + angular * own.inertia[(k, k)]),
        }
    }

    pub(crate) fn shapes(&self) -> &[Shape] {
        &self.shapes
    }

    pub(crate) fn collides(&self) -> bool {
        self.collides
    }

    pub(crate) fn rotors(&self) -> &[Rotor] {
        &self.rotors
    }

    pub(crate) fn is_vehicle(&self) -> bool {
        self.is_vehicle
    }

    /// Checks sizes, mass and inertia; `what` names the part.
    ///
    /// # Errors
    /// [`Error::Value`] for a number that is not finite or of the wrong sign, a mass without inertia or shape, and shapes as
    /// [`Shape::validate`] refuses.
    pub fn validate(&self, what: &str) -> Result<()> {
        for shape in &self.shapes {
            shape.validate(&format!("{what}: shape"))?;
        }
        for (name, rate) in [("linear damping", self.damping[0]), ("angular damping", self.damping[1])] {
            finite(&format!("{what}: {name}"), &[rate])?;
            if rate < 0.0 {
                return Err(Error::value(format!("{what}: {name}"), rate, "≥ 0", "Drag dissipates: check the sign."));
            }
        }
        let (name, given) = match &self.weight {
            Weight::Density(density) => ("density", *density),
            Weight::Given(mass) => ("mass", *mass),
            Weight::Explicit(own) => ("mass", own.mass),
        };
        finite(&format!("{what}: {name}"), &[given])?;
        if given < 0.0 {
            return Err(Error::value(format!("{what}: {name}"), given, "≥ 0", "Check the sign."));
        }
        if self.shapes.is_empty() && !matches!(self.weight, Weight::Explicit(_)) {
            let remedy = "Give it a shape, or its mass, centre and inertia with Solid::explicit.";
            return Err(Error::value(
                format!("{what}: number of shapes"),
                0,
                "≥ 1 where mass comes from shapes",
                remedy,
            ));
        }
        let own = self.properties();
        finite(&format!("{what}: centre of mass"), own.center_of_mass.as_slice())?;
        Inertia::from_matrix(&own.inertia).validate(what)
    }
}

const ORIGIN: Shape =
    Shape { geometry: Geometry::Sphere { radius: 0.0 }, position: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0] };

/// A capsule whose half balls are centred on two points, m.
pub fn rod(from: [f64; 3], to: [f64; 3], radius: f64) -> Shape {
    let (a, b) = (Vector3::from(from), Vector3::from(to));
    let along = b - a;
    let turn = match UnitQuaternion::rotation_between(&Vector3::z(), &along) {
        Some(turn) => turn,
        None if along.z < 0.0 => UnitQuaternion::new_unchecked(Quaternion::new(0.0, 1.0, 0.0, 0.0)),
        None => UnitQuaternion::identity(),
    };
    Shape {
        geometry: Geometry::Capsule { radius, length: along.norm() },
        position: ((a + b) * 0.5).into(),
        rotation: [turn.w, turn.i, turn.j, turn.k],
    }
}

/// Bodies welded into one: m = Σmᵢ, c = Σmᵢcᵢ/m, J = Σ(Jᵢ + mᵢ(‖dᵢ‖² − dᵢdᵢᵀ)) with dᵢ = cᵢ − c (Huygens–Steiner).
pub(crate) fn combined(parts: impl Iterator<Item = MassProperties> + Clone) -> MassProperties {
    let mass: f64 = parts.clone().map(|p| p.mass).sum();
    let moment: Vector3<f64> = parts.clone().map(|p| p.center_of_mass * p.mass).sum();
    // parts that balance leave a rounding error next to their lever arms
    let reach: f64 = parts.clone().map(|p| p.center_of_mass.norm() * p.mass).sum();
    let center_of_mass = if mass > 0.0 { Vector3::from(clean(moment, reach)) / mass } else { Vector3::zeros() };
    let inertia = parts
        .map(|p| {
            let d = p.center_of_mass - center_of_mass;
            p.inertia + (Matrix3::identity() * d.norm_squared() - d * d.transpose()) * p.mass
        })
        .sum();
    MassProperties { mass, center_of_mass, inertia }
}

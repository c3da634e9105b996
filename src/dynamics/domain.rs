//! What a physical number may be, by its nature: which sign it keeps under randomisation, and what files may say.

/// What a physical number may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Domain {
    /// A size: a mass, a time constant.
    Positive,
    /// A loss or a stiffness.
    NonNegative,
    /// A position, a product of inertia.
    AnySign,
    /// A component of a unit vector.
    UnitVector,
    /// A sense of rotation: +1 or −1.
    Spin,
}

impl Domain {
    /// Whether it has a sign that nothing may change: it then makes sense as a ratio to its nominal value.
    pub fn keeps_sign(self) -> bool {
        matches!(self, Self::Positive | Self::NonNegative)
    }

    /// Whether a number may be `x`: finite and as [`rule`](Self::rule) says; a positive one is above 1.18e-38, so that it stays so in
    /// `f32`. That a unit vector has length 1 is not seen by one component.
    pub fn allows(self, x: f64) -> bool {
        match self {
            Self::Positive => x > f64::from(f32::MIN_POSITIVE) && x.is_finite(),
            Self::NonNegative => x >= 0.0 && x.is_finite(),
            Self::AnySign | Self::UnitVector => x.is_finite(),
            Self::Spin => x.abs() == 1.0,
        }
    }

    /// In words of an error: `> 0`.
    pub fn rule(self) -> &'static str {
        match self {
            Self::Positive => "> 0",
            Self::NonNegative => "≥ 0",
            Self::AnySign | Self::UnitVector => "finite",
            Self::Spin => "+1 or -1",
        }
    }
}

//! Materials of contact.

use omnidrones::dynamics::GRAVITY;
use omnidrones::dynamics::contact::ContactMaterial;

#[test]
fn the_default_lets_a_drone_sink_half_a_millimetre_and_rk4_resolves_it() {
    let material = ContactMaterial::default();
    material.validate("default").unwrap();
    let (sink, rate) = (material.sink(0.7, 4), material.natural_frequency(0.7, 4));
    // 0.508 mm, 170.2 rad/s
    assert!((sink - 0.508e-3).abs() < 1e-6, "{sink}");
    assert!(rate * 2e-3 < 0.5 && (rate - 170.2).abs() < 0.1, "{rate}");
}

#[test]
fn a_material_made_for_a_body_sinks_as_asked_at_a_rate_independent_of_mass() {
    for mass in [0.027, 0.7, 5.0] {
        let material = ContactMaterial::resting(mass, 4, 5e-4);
        assert!((material.sink(mass, 4) / 5e-4 - 1.0).abs() < 1e-12);
        assert!((material.natural_frequency(mass, 4) - (1.5 * GRAVITY / 5e-4_f64).sqrt()).abs() < 1e-9);
    }
}

#[test]
fn materials_combine_alike_in_both_orders_and_with_their_equals_to_themselves() {
    let rubber = ContactMaterial { stiffness: 4e4, dissipation: 0.5, friction: 0.9, slip_speed: 2e-3 };
    let ice = ContactMaterial { stiffness: 1e6, dissipation: 0.1, friction: 0.04, slip_speed: 1e-3 };
    let both = rubber.against(&ice);
    assert_eq!(both, ice.against(&rubber));
    assert!((both.stiffness - 76923.076923).abs() < 1e-5 && (both.friction - 0.189737).abs() < 1e-6, "{both:?}");
    let own = rubber.against(&rubber);
    assert!((own.stiffness / 4e4 - 1.0).abs() < 1e-15 && (own.friction / 0.9 - 1.0).abs() < 1e-15);
}

#[test]
fn a_material_is_toml_with_defaults_and_its_errors_name_the_key() {
    let material: ContactMaterial = toml::from_str("friction = 0.8").unwrap();
    assert_eq!(material, ContactMaterial { friction: 0.8, ..ContactMaterial::default() });
    assert!(toml::from_str::<ContactMaterial>("bounce = 0.8").is_err());
    for (bad, start) in [
        (ContactMaterial { stiffness: 0.0, ..material }, "floor: stiffness is 0, but it must be between"),
        (ContactMaterial { slip_speed: 0.0, ..material }, "floor: slip_speed is 0"),
        (ContactMaterial { friction: -0.1, ..material }, "floor: friction is -0.1"),
        (ContactMaterial { dissipation: f64::NAN, ..material }, "floor: dissipation is NaN"),
    ] {
        let text = bad.validate("floor").unwrap_err().to_string();
        assert!(text.starts_with(start), "{text}");
    }
}

//! Ground that is not level.

use num_dual::Dual64;
use omnidrones::dynamics::{GroundWave, UnevenGround};

fn hills() -> UnevenGround {
    let wave = |amplitude, number, phase| GroundWave { amplitude, number, phase };
    UnevenGround { slope: [0.1, -0.05], waves: vec![wave(0.2, [0.8, 0.3], 0.4), wave(0.05, [-1.1, 2.0], 2.0)] }
}

#[test]
fn slopes_are_the_derivatives_of_the_rise() {
    let relief = hills();
    for i in 0..50 {
        let (x, y) = (0.37 * f64::from(i) - 9.0, 4.0 - 0.21 * f64::from(i));
        let (_, slope) = relief.rise(x, y);
        for k in 0..2 {
            let mut at = [Dual64::from(x), Dual64::from(y)];
            at[k].eps = 1.0;
            assert!((relief.rise(at[0], at[1]).0.eps - slope[k]).abs() < 1e-14);
        }
    }
}

#[test]
fn the_distance_to_a_slope_is_exact_and_that_to_hills_is_close_near_them() {
    let slope = UnevenGround::inclined(0.3);
    let (d, n) = slope.surface([1.0, 2.0, 1.0 * 0.3_f64.tan() + 0.5], 0.0);
    assert!((d - 0.5 * 0.3_f64.cos()).abs() < 1e-15 && (n[0] + 0.3_f64.sin()).abs() < 1e-15, "{d} {n:?}");
    let relief = hills();
    let mut worst = 0.0_f64;
    for i in 0..200 {
        let foot = [0.13 * f64::from(i) - 10.0, 5.0 - 0.07 * f64::from(i)];
        let (h, _) = relief.rise(foot[0], foot[1]);
        let (_, n) = relief.surface([foot[0], foot[1], h], 0.0);
        let up: [f64; 3] = std::array::from_fn(|k| [foot[0], foot[1], h][k] + 0.05 * n[k]);
        worst = worst.max((relief.surface(up, 0.0).0 - 0.05).abs());
    }
    // measured 1.3e-4 m at 5 cm
    println!("5 cm above hills the distance is off by at most {worst:.1e} m");
    assert!(worst < 5e-4);
}

#[test]
fn ground_too_steep_or_too_rough_is_refused() {
    let mut relief = hills();
    relief.validate("ground").unwrap();
    relief.waves[0].amplitude = 3.0;
    let text = relief.validate("ground").unwrap_err().to_string();
    assert!(text.starts_with("ground: steepest place is '2.789 m per m'") || text.contains("2.789 m per m"), "{text}");
    relief.waves = vec![relief.waves[1]; 65];
    let text = relief.validate("ground").unwrap_err().to_string();
    assert!(text.starts_with("ground: number of waves is 65, over the limit of 64"), "{text}");
}

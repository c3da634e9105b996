//! The active set alone: programs solved by hand.

use omnidrones::controllers::allocation::active_set::{BoxQp, Factor, Iterate, Tolerances};

/// H = [[2, 1], [1, 2]], q = (−4, −5): free optimum (1, 2).
fn two() -> BoxQp<f64, 2> {
    BoxQp { hessian: [[2.0, 1.0], [1.0, 2.0]], linear: [-4.0, -5.0], lower: [0.0; 2], upper: [3.0; 2] }
}

fn solved(qp: &BoxQp<f64, 2>) -> Iterate<f64, 2> {
    let mut x = qp.start(2, &[0.5, 0.5]);
    let mut factor = Factor::new();
    for _ in 0..10 {
        qp.step(2, &mut x, &mut factor, true, Tolerances::DOUBLE);
    }
    x
}

#[test]
fn a_small_program_has_the_answer_found_by_hand() {
    let mut qp = two();
    let x = solved(&qp);
    assert!((x.inputs[0] - 1.0).abs() < 1e-15 && (x.inputs[1] - 2.0).abs() < 1e-15, "{x:?}");
    // with u₂ ≤ 1: u₁ = (4 − 1)/2
    qp.upper[1] = 1.0;
    let x = solved(&qp);
    assert_eq!((x.inputs, x.status, x.done), ([1.5, 1.0], [0.0, 1.0], 1.0));
    // multiplier of the held input: 1.5 + 2 − 5 = −1.5; room of the free one: 1.5
    assert_eq!(qp.gap(2, &x), 1.5);
}

#[test]
fn a_failed_input_stays_at_zero_and_costs_no_more_steps() {
    let mut qp = two();
    qp.upper[1] = 0.0;
    let x = solved(&qp);
    assert_eq!((x.inputs, x.done), ([2.0, 0.0], 1.0));
}

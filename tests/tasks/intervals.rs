//! Intervals of shares.

use omnidrones::tasks::wilson;

#[test]
fn intervals_are_those_of_newcombe_1998() {
    // Statistics in Medicine 17, table I, method 3
    for (hits, n, wanted) in [(81, 263, [0.2553, 0.3662]), (15, 148, [0.0624, 0.1605]), (0, 20, [0.0, 0.1611])] {
        let got = wilson(hits, n);
        assert!((got[0] - wanted[0]).abs() < 5e-5 && (got[1] - wanted[1]).abs() < 5e-5, "{hits} of {n}: {got:?}");
    }
    assert_eq!((wilson(0, 0), wilson(8, 8)[1]), ([0.0, 1.0], 1.0));
}

//! When several rates come round together.

/// Steps until what happens every `a` and what happens every `b` steps, both above 0, happens in one step again; at most `u64::MAX`.
pub(crate) fn common_period(a: u64, b: u64) -> u64 {
    let (mut x, mut y) = (a, b);
    while y > 0 {
        (x, y) = (y, x % y);
    }
    (a / x).saturating_mul(b)
}

#[cfg(test)]
mod tests {
    use super::common_period;

    #[test]
    fn periods_come_round_together_and_do_not_overflow() {
        assert_eq!([common_period(4, 6), common_period(1, 7), common_period(5, 5)], [12, 7, 5]);
        assert_eq!([1_000_000, 999_999, 999_997, 999_983].into_iter().fold(1, common_period), u64::MAX);
    }
}

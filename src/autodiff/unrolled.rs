//! Loops over the components of a vector, written out.
//!
//! A kernel has thousands of loops over three or four components. The compiler unrolls them all, but analyses each as a
//! loop first, in functions of tens of thousands of instructions: more than half of the time that this crate took to
//! compile. Numbers that live in such an array stay in registers only once it is unrolled, too.

/// `for i in 0..N` for a constant N ≤ 16, as N copies of the body.
macro_rules! unrolled {
    ($i:ident in 0..3 $body:block) => {
        $crate::autodiff::unrolled::unrolled!(@all $i $body [0 1 2])
    };
    ($i:ident in 0..4 $body:block) => {
        $crate::autodiff::unrolled::unrolled!(@all $i $body [0 1 2 3])
    };
    ($i:ident in 0..$n:ident $body:block) => {
        $crate::autodiff::unrolled::unrolled!(@below $i $n $body [0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15])
    };
    (@all $i:ident $body:block [$($k:literal)*]) => {{
        $({
            let $i: usize = $k;
            $body
        })*
    }};
    (@below $i:ident $n:ident $body:block [$($k:literal)*]) => {{
        const { assert!($n <= 16, "more components than the macro writes out") };
        $(if const { $k < $n } {
            let $i: usize = $k;
            $body
        })*
    }};
}
pub(crate) use unrolled;

#[cfg(test)]
mod tests {
    fn visited<const N: usize>() -> Vec<usize> {
        let mut all = Vec::new();
        unrolled!(i in 0..N {
            all.push(i);
        });
        all
    }

    #[test]
    fn every_component_is_visited_once_and_in_order() {
        assert!(visited::<0>().is_empty());
        assert_eq!(visited::<3>(), [0, 1, 2]);
        assert_eq!(visited::<16>(), (0..16).collect::<Vec<_>>());
    }
}

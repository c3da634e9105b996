//! Loops over the components of a vector, written out.
//!
//! A kernel has thousands of loops over three or four components. The compiler unrolls them all, but analyses each as a
//! loop first, in functions of tens of thousands of instructions: more than half of the time that the library took to
//! compile, and once more a tenth where series were left as loops. Numbers that live in such an array stay in registers
//! only once it is unrolled, too.

/// `for i in 0..N` or `1..N` for a constant N, as N copies of the body; a loop beyond the sixteenth, or the seventh from 1 on.
#[doc(hidden)]
#[macro_export]
macro_rules! unrolled {
    ($i:ident in 0..2 $body:block) => {
        $crate::unrolled!(@all $i $body [0 1])
    };
    ($i:ident in 0..3 $body:block) => {
        $crate::unrolled!(@all $i $body [0 1 2])
    };
    ($i:ident in 0..4 $body:block) => {
        $crate::unrolled!(@all $i $body [0 1 2 3])
    };
    ($i:ident in 0..6 $body:block) => {
        $crate::unrolled!(@all $i $body [0 1 2 3 4 5])
    };
    ($i:ident in 0..$n:ident $body:block) => {
        $crate::unrolled!(@below $i $n $body [0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15] 16)
    };
    ($i:ident in 1..$n:ident $body:block) => {
        $crate::unrolled!(@below $i $n $body [1 2 3 4 5 6 7] 8)
    };
    (@all $i:ident $body:block [$($k:literal)*]) => {{
        $({
            let $i: usize = $k;
            $body
        })*
    }};
    (@below $i:ident $n:ident $body:block [$($k:literal)*] $rest:literal) => {{
        $(if const { $k < $n } {
            let $i: usize = $k;
            $body
        })*
        if const { $rest < $n } {
            for $i in $rest..$n $body
        }
    }};
}
pub use crate::unrolled;

#[cfg(test)]
mod tests {
    fn visited<const N: usize>() -> Vec<usize> {
        let mut all = Vec::new();
        unrolled!(i in 0..N {
            all.push(i);
        });
        unrolled!(i in 1..N {
            all.push(i);
        });
        all
    }

    #[test]
    fn every_component_is_visited_once_and_in_order() {
        fn is_visited<const N: usize>() {
            assert_eq!(visited::<N>(), (0..N).chain(1..N).collect::<Vec<_>>());
        }
        is_visited::<0>();
        is_visited::<1>();
        is_visited::<3>();
        is_visited::<8>();
        is_visited::<16>();
        is_visited::<19>();
    }
}

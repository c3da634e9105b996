//! Settings with their defaults beside them.

/// A struct whose every field stands with its default: `name: type = default,`. The documentation of the field says it too.
#[macro_export]
macro_rules! with_defaults {
    (
        $(#[$meta:meta])*
        $vis:vis struct $name:ident {
            $($(#[$of_field:meta])* $field_vis:vis $field:ident: $type:ty = $default:expr,)+
        }
    ) => {
        $(#[$meta])*
        $vis struct $name {
            $(
                $(#[$of_field])*
                #[doc = ""]
                #[doc = concat!("Default: `", stringify!($default), "`.")]
                $field_vis $field: $type,
            )+
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)+ }
            }
        }
    };
}

pub use crate::with_defaults;

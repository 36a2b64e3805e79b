//! Enums whose variants have names, in files, arguments and results.
//!
//! Input: an enum with its variants, each with its name. Output: the list of the variants and the name of each. Written
//! once, since a name given in two lists can differ.

/// Gives an enum the constant `ALL` and the function `name`.
macro_rules! named_variants {
    ($enum:ident { $($variant:ident = $name:literal),+ $(,)? }) => {
        impl $enum {
            /// Every variant, in the order in which they are shown.
            pub const ALL: [$enum; [$($name),+].len()] = [$($enum::$variant),+];

            /// The name in files, arguments and results.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $($enum::$variant => $name,)+
                }
            }
        }
    };
}
pub(crate) use named_variants;

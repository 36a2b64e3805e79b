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

/// Whether a name fits a pattern, in which `*` stands for any characters and `?` for one.
#[must_use]
pub fn fits_pattern(pattern: &str, name: &str) -> bool {
    let (pattern, name): (Vec<char>, Vec<char>) = (pattern.chars().collect(), name.chars().collect());
    let (mut at, mut from) = (0, 0);
    // The last star, and where what it stands for ends so far.
    let mut star: Option<(usize, usize)> = None;
    while from < name.len() {
        match pattern.get(at) {
            Some('*') => {
                star = Some((at, from));
                at += 1;
            }
            Some(&c) if c == '?' || c == name[from] => (at, from) = (at + 1, from + 1),
            _ => match star {
                Some((place, end)) => {
                    star = Some((place, end + 1));
                    (at, from) = (place + 1, end + 1);
                }
                None => return false,
            },
        }
    }
    pattern[at..].iter().all(|&c| c == '*')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_are_names_with_stars_and_question_marks() {
        for (pattern, name, fits) in [
            ("hid", "hid", true),
            ("hid", "hidden", false),
            ("hid*", "hidden", true),
            ("hid*", "hid", true),
            ("*d?n", "hidden", true),
            ("*d?n", "hidn", false),
            ("*", "", true),
            ("?", "", false),
            ("a*b*c", "axbxbc", true),
            ("a*b*c", "axbxb", false),
            ("**", "x", true),
        ] {
            assert_eq!(fits_pattern(pattern, name), fits, "{pattern} {name}");
        }
    }
}

//! Names in files, arguments and results.
//!
//! `named_variants!` takes the variants of an enum, with their names where these differ from the
//! variants. A variant after a semicolon has a name of its own, and is in no list. The output is
//! the list of variants, their names, and the enum if the declaration is given. So each name is
//! written once. [`printable`] takes a text of any origin, and returns it as it may be displayed.

use std::borrow::Cow;

/// Gives an enum the constant `ALL` and the function `name`.
#[macro_export]
macro_rules! named_variants {
    ($(#[$about:meta])* pub enum $enum:ident { $($(#[$of:meta])* $variant:ident = $name:literal,)+ }) => {
        $(#[$about])*
        pub enum $enum {
            $($(#[$of])* $variant,)+
        }
        $crate::named_variants!($enum { $($variant = $name),+ });
    };
    ($enum:ident { $($variant:ident),+ $(; $other:pat => $given:expr)? }) => {
        $crate::named_variants!($enum { $($variant = stringify!($variant)),+ $(; $other => $given)? });
    };
    ($enum:ident { $($variant:ident = $name:expr),+ $(,)? $(; $other:pat => $given:expr)? }) => {
        impl $enum {
            /// Every listed variant, in the order of display.
            pub const ALL: [$enum; [$($name),+].len()] = [$($enum::$variant),+];

            /// The name in files, arguments and results.
            pub const fn name(self) -> &'static str {
                match self {
                    $($enum::$variant => $name,)+
                    $($other => $given,)?
                }
            }
        }
    };
}
pub use named_variants;

/// Whether a character controls a terminal, changes the order of the text around it, ends a line,
/// or is not allowed in XML.
pub fn is_unprintable(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}' | '\u{fffe}' | '\u{ffff}')
}

/// The text with U+FFFD in place of every unprintable character but line ends and tabs.
///
/// Names, labels, file names and quoted content come from files of other people. All output of them
/// passes through here, so that no name moves a cursor, colours a terminal or makes an unreadable
/// picture.
pub fn printable(text: &str) -> Cow<'_, str> {
    fn is_replaced(c: char) -> bool {
        is_unprintable(c) && !matches!(c, '\n' | '\t')
    }
    match text.contains(is_replaced) {
        true => Cow::Owned(text.replace(is_replaced, "\u{fffd}")),
        false => Cow::Borrowed(text),
    }
}

/// The text for XML and HTML: [`printable`] and escaped.
pub fn markup(text: &str) -> String {
    printable(text).replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The least Jaro-Winkler similarity at which a name is suggested.
const LEAST_SIMILARITY: f64 = 0.84;

/// The question whether the name most similar to a word was meant, with a space after it; empty
/// where no name is similar.
pub fn did_you_mean<'n>(word: &str, names: impl IntoIterator<Item = &'n str>) -> String {
    let with_similarity = |name: &'n str| (strsim::jaro_winkler(&word.to_lowercase(), &name.to_lowercase()), name);
    let best = names.into_iter().map(with_similarity).max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(a.1)));
    match best {
        Some((similarity, name)) if similarity >= LEAST_SIMILARITY => format!("did you mean '{name}'? "),
        _ => String::new(),
    }
}

/// Whether a name fits a pattern, in which `*` matches any characters and `?` one.
pub fn fits_pattern(pattern: &str, name: &str) -> bool {
    let (pattern, name): (Vec<char>, Vec<char>) = (pattern.chars().collect(), name.chars().collect());
    let (mut at, mut from) = (0, 0);
    // The last star, and the end of its match so far.
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
    fn a_slip_of_the_pen_is_recognised_and_another_name_is_not() {
        let names = ["vtsnn-slip", "vtsnn-slip-srm", "slip-tactile", "tiny"];
        for (word, meant) in [
            ("vtsnn-slp", "did you mean 'vtsnn-slip'? "),
            ("VTSNN_slip", "did you mean 'vtsnn-slip'? "),
            ("slip-tactil", "did you mean 'slip-tactile'? "),
            ("tinny", "did you mean 'tiny'? "),
            ("resnet", ""),
            ("", ""),
        ] {
            assert_eq!(did_you_mean(word, names), meant, "{word}");
        }
        assert_eq!(did_you_mean("x", []), "");
    }

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

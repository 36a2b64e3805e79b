//! Changes as text: `2^-2*x1*y0 - 2^-2*y1*x0`.
//!
//! ```text
//! change  := product (('+' | '-') product)*    a leading sign is allowed; blanks do not matter
//! product := one dependency, literals and factors in any order, joined by '*'
//! dependency := x0 | y0 | u0 .. u9      the first x0 or y0, else u; a further x0 or y0 is a factor
//! literal := n | 2^e | n*2^e | '(' [sign] literal ')'
//! factor  := x1 x2 y1 y2 y3 r1 w d t | '(' factor sign n ')' | '(' n sign factor ')' | sgn(..)
//! ```
//!
//! The grammar is lava's (`product_series.py` of lava-nc 0.10), without what it reads wrongly.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::rule::{
    Change, Dependency, EXPONENTS, Factor, MANTISSAS, Product, Quantity, SLOWEST, Trace, Variable, WIDEST,
};

/// The longest text, in bytes.
const LONGEST: usize = 2000;
/// Bits of a mantissa in lava's 32-bit products.
const MANTISSA_BITS: u32 = 4;
/// The greatest magnitude of a literal.
const GREATEST: i64 = 1 << 20;

/// Reason why a text is no change, and the byte at which it ends to be one.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct Problem {
    /// Byte in the text.
    pub at: usize,
    /// A sentence with the remedy.
    pub message: String,
}

/// Parses a change.
///
/// # Errors
/// A [`Problem`] at a byte of the text.
pub fn parse(text: &str) -> Result<Change, Problem> {
    if text.len() > LONGEST {
        return Err(Problem { at: LONGEST, message: format!("a rule has at most {LONGEST} bytes") });
    }
    let mut parser = Parser { text, at: 0, slow: None };
    let mut products = Vec::new();
    let mut negative = match parser.peek() {
        "+" | "-" => parser.next() == "-",
        _ => false,
    };
    loop {
        products.push(parser.product(negative)?);
        negative = match parser.peek() {
            "" => break,
            "+" => false,
            "-" => true,
            other => return parser.wrong(format!("expected +, - or * but found '{other}'")),
        };
        parser.next();
    }
    Ok(Change { products, slow: parser.slow })
}

struct Parser<'t> {
    text: &'t str,
    /// Byte where the next token begins.
    at: usize,
    /// The k of u.
    slow: Option<u8>,
}

/// What one operand of a product is.
enum Operand {
    Literal {
        mantissa: i64,
        exponent: i64,
    },
    Factor(Factor),
    /// `c - quantity`, which is minus (quantity - c).
    Negated(Factor),
    Slow(u8),
}

impl<'t> Parser<'t> {
    fn wrong<T>(&self, message: impl Into<String>) -> Result<T, Problem> {
        Err(Problem { at: self.at, message: message.into() })
    }

    /// The next token: letters and digits, or one other character; empty at the end.
    fn peek(&mut self) -> &'t str {
        let rest = self.text[self.at..].trim_start();
        self.at = self.text.len() - rest.len();
        fn part(c: char) -> bool {
            c.is_ascii_alphanumeric() || c == '_' || c == '.'
        }
        let length = match rest.chars().next() {
            Some(c) if part(c) => rest.find(|c: char| !part(c)).unwrap_or(rest.len()),
            other => other.map_or(0, char::len_utf8),
        };
        &rest[..length]
    }

    fn next(&mut self) -> &'t str {
        let token = self.peek();
        self.at += token.len();
        token
    }

    fn expect(&mut self, token: &str) -> Result<(), Problem> {
        match self.peek() {
            found if found == token => {
                self.at += found.len();
                Ok(())
            }
            "" => self.wrong(format!("expected '{token}' but the rule ends")),
            found => self.wrong(format!("expected '{token}' but found '{found}'")),
        }
    }

    /// A product, negated by a sign before it.
    fn product(&mut self, negative: bool) -> Result<Product, Problem> {
        self.peek();
        let start = self.at;
        let (mut mantissa, mut exponent) = (if negative { -1 } else { 1 }, 0);
        let (mut dependency, mut slow) = (None, false);
        let mut factors = Vec::new();
        loop {
            self.peek();
            let at = self.at;
            match self.operand()? {
                Operand::Literal { mantissa: by, exponent: plus } => {
                    (mantissa, exponent) = (mantissa * by, exponent + plus);
                }
                Operand::Slow(k) => {
                    if let Some(other) = self.slow.filter(|other| *other != k) {
                        let message = format!("a rule has one u, but u{other} and u{k} are used: use one of them");
                        return Err(Problem { at, message });
                    }
                    (self.slow, slow) = (Some(k), true);
                }
                Operand::Factor(Factor { of: Quantity::Pre, plus: 0, sign: false }) if dependency.is_none() => {
                    dependency = Some(Dependency::Pre);
                }
                Operand::Factor(Factor { of: Quantity::Post, plus: 0, sign: false }) if dependency.is_none() => {
                    dependency = Some(Dependency::Post);
                }
                Operand::Factor(factor) => factors.push(factor),
                Operand::Negated(factor) => {
                    mantissa = -mantissa;
                    factors.push(factor);
                }
            }
            if mantissa.abs() > GREATEST || i64::abs(exponent) > GREATEST {
                return Err(Problem { at, message: format!("the product's numbers exceed {GREATEST}") });
            }
            if self.peek() != "*" {
                break;
            }
            self.next();
        }
        let failed = |message: String| Err(Problem { at: start, message });
        let Some(when) = dependency.or(slow.then_some(Dependency::Epoch)) else {
            return failed(
                "a product needs x0, y0 or u0 to u9, which say when it counts: write *u0 for every epoch".into(),
            );
        };
        while mantissa.abs() > 7 && mantissa % 2 == 0 && exponent < *EXPONENTS.end() {
            (mantissa, exponent) = (mantissa / 2, exponent + 1);
        }
        if !MANTISSAS.contains(&mantissa) || !EXPONENTS.contains(&exponent) {
            let message = format!(
                "{mantissa}*2^{exponent} is not a number n*2^e with n from -8 to 7 and e from -7 to 8: choose a near one"
            );
            return failed(message);
        }
        let product = Product { when, mantissa: mantissa as i8, exponent: exponent as i8, factors };
        let bits = product.bits() + MANTISSA_BITS;
        if bits > WIDEST {
            let message =
                format!("its factors and mantissa have {bits} bits, the limit is {WIDEST}: use fewer factors");
            return failed(message);
        }
        Ok(product)
    }

    fn operand(&mut self) -> Result<Operand, Problem> {
        let token = self.peek();
        if token == "(" {
            self.next();
            let operand = self.bracket()?;
            self.expect(")")?;
            return Ok(operand);
        }
        if token == "sgn" {
            self.next();
            self.expect("(")?;
            self.peek();
            let at = self.at;
            let inner = self.bracket()?;
            self.expect(")")?;
            return match inner {
                Operand::Factor(factor) if matches!(factor.of, Quantity::Variable(_)) && !factor.sign => {
                    Ok(Operand::Factor(Factor { sign: true, ..factor }))
                }
                _ => Err(Problem { at, message: "sgn takes w, d or t, or one of them plus a number".to_string() }),
            };
        }
        if token.starts_with(|c: char| c.is_ascii_digit()) {
            return self.literal();
        }
        self.name()
    }

    /// The content of brackets: a signed literal, or a quantity and a number.
    fn bracket(&mut self) -> Result<Operand, Problem> {
        let token = self.peek();
        if token == "-" || token == "+" {
            self.next();
            if !self.peek().starts_with(|c: char| c.is_ascii_digit() || c == '(') {
                return self
                    .wrong("a sign before a quantity in brackets is not supported: write the sign before the product");
            }
            let inner = self.operand_literal()?;
            let Operand::Literal { mantissa, exponent } = inner else {
                return self.wrong("expected a number after the sign");
            };
            let mantissa = if token == "-" { -mantissa } else { mantissa };
            return Ok(Operand::Literal { mantissa, exponent });
        }
        let first = self.operand()?;
        let sign = match self.peek() {
            "+" => 1,
            "-" => -1,
            _ => {
                return match first {
                    Operand::Literal { .. } => Ok(first),
                    // Brackets around x0 or y0 would leave open whether it is the dependency.
                    Operand::Factor(factor) if !matches!(factor.of, Quantity::Pre | Quantity::Post) => {
                        Ok(Operand::Factor(factor))
                    }
                    _ => self.wrong("brackets hold a number, or a quantity plus or minus a number: remove them"),
                };
            }
        };
        self.next();
        self.peek();
        let at = self.at;
        let second = self.operand()?;
        fn whole(mantissa: i64, exponent: i64) -> Option<i32> {
            match exponent {
                0..=20 => mantissa
                    .checked_mul(1 << exponent)
                    .filter(|value| value.abs() <= GREATEST)
                    .map(|value| value as i32),
                _ => None,
            }
        }
        match (first, second) {
            (Operand::Factor(factor), Operand::Literal { mantissa, exponent }) if factor.plus == 0 && !factor.sign => {
                match whole(mantissa, exponent) {
                    Some(value) => Ok(Operand::Factor(Factor { plus: sign * value, ..factor })),
                    None => Err(Problem { at, message: "a number beside a quantity is a whole number".to_string() }),
                }
            }
            (Operand::Literal { mantissa, exponent }, Operand::Factor(factor)) if factor.plus == 0 && !factor.sign => {
                match (whole(mantissa, exponent), sign) {
                    (Some(value), 1) => Ok(Operand::Factor(Factor { plus: value, ..factor })),
                    (Some(value), _) => Ok(Operand::Negated(Factor { plus: -value, ..factor })),
                    (None, _) => {
                        Err(Problem { at, message: "a number beside a quantity is a whole number".to_string() })
                    }
                }
            }
            _ => Err(Problem { at, message: "brackets hold one quantity and one number".to_string() }),
        }
    }

    /// A literal, possibly in further brackets.
    fn operand_literal(&mut self) -> Result<Operand, Problem> {
        if self.peek() != "(" {
            return self.literal();
        }
        self.next();
        let inner = self.bracket()?;
        self.expect(")")?;
        Ok(inner)
    }

    /// `n` or `n^e`, where n is 2.
    fn literal(&mut self) -> Result<Operand, Problem> {
        let number = self.integer()?;
        if self.peek() != "^" {
            return Ok(Operand::Literal { mantissa: number, exponent: 0 });
        }
        if number != 2 {
            return self.wrong(format!("only powers of 2 are known, not of {number}"));
        }
        self.next();
        let negative = match self.peek() {
            "-" | "+" => self.next() == "-",
            _ => false,
        };
        let exponent = self.integer()?;
        Ok(Operand::Literal { mantissa: 1, exponent: if negative { -exponent } else { exponent } })
    }

    fn integer(&mut self) -> Result<i64, Problem> {
        let token = self.peek();
        match token.parse::<i64>() {
            Ok(number) if number <= GREATEST => {
                self.next();
                Ok(number)
            }
            Ok(number) => self.wrong(format!("the number {number} exceeds {GREATEST}")),
            Err(_) if token.is_empty() => self.wrong("expected a whole number but the rule ends"),
            Err(_) => self.wrong(format!("expected a whole number but found '{token}'")),
        }
    }

    fn name(&mut self) -> Result<Operand, Problem> {
        let token = self.peek();
        let of = match token {
            "x0" => Quantity::Pre,
            "y0" => Quantity::Post,
            "w" => Quantity::Variable(Variable::Weight),
            "d" => Quantity::Variable(Variable::Delay),
            "t" => Quantity::Variable(Variable::Tag),
            _ => match (Trace::ALL.into_iter().find(|trace| trace.name() == token), token.strip_prefix('u')) {
                (Some(trace), _) => Quantity::Trace(trace),
                (None, Some(k)) => match k.parse::<u8>() {
                    Ok(k) if k <= SLOWEST => {
                        self.next();
                        return Ok(Operand::Slow(k));
                    }
                    _ => return self.wrong(format!("'{token}' is unknown: u0 to u{SLOWEST} name every 2^k-th epoch")),
                },
                (None, None) if token.is_empty() => {
                    return self.wrong("expected a factor but the rule ends");
                }
                (None, None) => {
                    let message = format!(
                        "'{token}' is unknown: factors are x0 x1 x2 y0 y1 y2 y3 r1 u0 to u9 w d t, numbers and sgn(..)"
                    );
                    return self.wrong(message);
                }
            },
        };
        self.next();
        Ok(Operand::Factor(Factor { of, plus: 0, sign: false }))
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Quantity::Pre => "x0",
            Quantity::Post => "y0",
            Quantity::Trace(trace) => trace.name(),
            Quantity::Variable(Variable::Weight) => "w",
            Quantity::Variable(Variable::Delay) => "d",
            Quantity::Variable(Variable::Tag) => "t",
        })
    }
}

impl fmt::Display for Factor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.sign, self.plus) {
            (true, 0) => write!(f, "sgn({})", self.of),
            (true, plus) => write!(f, "sgn({}{plus:+})", self.of),
            (false, 0) => write!(f, "{}", self.of),
            (false, plus) => write!(f, "({}{plus:+})", self.of),
        }
    }
}

/// The text that [`parse`] reads as this change.
impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, Product { when, mantissa, exponent, factors }) in self.products.iter().enumerate() {
            match (place, *mantissa < 0) {
                (0, true) => f.write_str("-")?,
                (0, false) => {}
                (_, true) => f.write_str(" - ")?,
                (_, false) => f.write_str(" + ")?,
            }
            write!(f, "{}*2^{exponent}", mantissa.unsigned_abs())?;
            match when {
                Dependency::Pre => f.write_str("*x0")?,
                Dependency::Post => f.write_str("*y0")?,
                Dependency::Epoch => write!(f, "*u{}", self.slow.unwrap_or(0))?,
            }
            factors.iter().try_for_each(|factor| write!(f, "*{factor}"))?;
        }
        Ok(())
    }
}

impl Serialize for Change {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Change {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        if text.is_empty() { Ok(Change::default()) } else { parse(&text).map_err(serde::de::Error::custom) }
    }
}

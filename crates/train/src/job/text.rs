//! Fields of a training file replaced in its text, for studies that vary them.

/// The text with the value of a field of the outermost struct replaced, or added when the field is
/// not there.
///
/// Returns `None` when the text has no outermost struct. What the new value means is for the parser
/// to say.
#[must_use]
pub fn with_field(text: &str, key: &str, value: &str) -> Option<String> {
    let mut fields = Vec::new();
    let (mut depth, mut begin) = (0usize, None);
    let mut chars = text.char_indices().peekable();
    let mut end = None;
    while let Some((at, c)) = chars.next() {
        match c {
            '"' => {
                while let Some((_, inside)) = chars.next() {
                    match inside {
                        '\\' => drop(chars.next()),
                        '"' => break,
                        _ => {}
                    }
                }
            }
            '/' if chars.next_if(|next| next.1 == '/').is_some() => {
                while chars.next_if(|next| next.1 != '\n').is_some() {}
            }
            '(' | '[' | '{' => {
                depth += 1;
                if depth == 1 {
                    begin = Some(at + 1);
                }
            }
            ')' | ']' | '}' => {
                depth = depth.saturating_sub(1);
                if depth == 0 {
                    fields.push(begin?..at);
                    end = Some(at);
                    break;
                }
            }
            ',' if depth == 1 => {
                fields.push(begin?..at);
                begin = Some(at + 1);
            }
            _ => {}
        }
    }
    let end = end?;
    for range in fields {
        // Comments may stand before a field's name, on lines of their own.
        let mut line_start = range.start;
        for line in text[range.clone()].split_inclusive('\n') {
            let code = line.split("//").next().unwrap_or("");
            if !code.trim().is_empty() {
                let colon = code.find(':').filter(|&colon| code[..colon].trim() == key);
                if let Some(colon) = colon {
                    return Some(format!("{}: {value}{}", &text[..line_start + colon], &text[range.end..]));
                }
                break;
            }
            line_start += line.len();
        }
    }
    let before = text[..end].trim_end();
    let comma = if before.ends_with([',', '(']) { "" } else { "," };
    Some(format!("{before}{comma}\n    {key}: {value},\n{}", &text[end..]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_is_replaced_or_added() {
        let text = "// Training(\nTraining(a: 1, /* x */ b: (c: 2, a: 3), // d: 5,\n    d: \"x,)\",)";
        assert_eq!(with_field(text, "a", "7").unwrap(), text.replace("(a: 1", "(a: 7"));
        assert_eq!(with_field(text, "d", "8").unwrap(), text.replace("d: \"x,)\"", "d: 8"));
        assert!(with_field(text, "e", "9").unwrap().ends_with("\"x,)\",\n    e: 9,\n)"));
        assert_eq!(with_field("a", "b", "c"), None);
    }
}

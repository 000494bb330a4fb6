//! Words for a terminal. Ids, serial numbers and file names come from outside: what steers a terminal in them is written out, here and
//! nowhere else.
#![allow(clippy::print_stderr)] // denied everywhere else, so that all of it comes through here

use std::borrow::Cow;
use std::fmt::Write;

/// The text with every character written out that steers a terminal or turns text round: `\u001b`. That is how JSON writes them, so
/// an object stays the same. Lines and tabs stay.
pub fn printable(text: &str) -> Cow<'_, str> {
    let steers = |c: char| {
        c.is_control() && !matches!(c, '\n' | '\t')
            || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    };
    if !text.contains(steers) {
        return Cow::Borrowed(text);
    }
    let mut written = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if steers(c) {
            // All of them have at most four digits; writing to a string cannot fail.
            write!(written, "\\u{:04x}", u32::from(c)).unwrap_or_default();
        } else {
            written.push(c);
        }
    }
    Cow::Owned(written)
}

/// A line on standard error.
pub fn say(text: &str) {
    eprintln!("{}", printable(text));
}

/// An error with its causes, each once: most of our errors have their cause's words in their own.
pub fn text_of(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain() {
        let cause = cause.to_string();
        if text.is_empty() {
            text = cause;
        } else if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_steers_a_terminal_is_written_out() {
        assert_eq!(
            printable("a\u{1b}[31mb\u{7}\u{9b}2J\r\u{202e}"),
            "a\\u001b[31mb\\u0007\\u009b2J\\u000d\\u202e"
        );
        for same in ["b02/a: 550.06 mm ± 0.57\n\tm³ 箱子", ""] {
            assert!(matches!(printable(same), Cow::Borrowed(text) if text == same));
        }
        let object = serde_json::json!({"serial": "\u{9b}2J\u{1b}"});
        let text = object.to_string();
        assert!(text.contains('\u{9b}'));
        assert_eq!(serde_json::from_str::<serde_json::Value>(&printable(&text)).unwrap(), object);
    }

    #[test]
    fn a_cause_is_told_once() {
        let cause = std::io::Error::other("no room");
        let error = boxline::Error::new(boxline::ErrorKind::Io, format!("a.json: cannot write: {cause}"));
        let error = anyhow::Error::from(error.with_source(cause)).context("outer");
        assert_eq!(text_of(&error), "outer: a.json: cannot write: no room");
    }
}

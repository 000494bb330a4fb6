//! From bytes to a JSON value. What `serde_json` lets pass or explains badly is caught here: a byte order mark, UTF-16, a key that is
//! given twice.

use boxline::{Error, ErrorKind};
use serde::Deserialize;
use serde::de::{Deserializer, Error as _, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Number, Value};

/// Parses the bytes of a file; `name` and `kind` are for the error.
///
/// # Errors
/// Of `kind`, with `name` in front: not UTF-8, not JSON, or a key twice in one object, of which a reader would take one and a person
/// may have meant the other.
pub fn parse_json(bytes: &[u8], name: &str, kind: ErrorKind) -> Result<Value, Error> {
    // Editors put it in front; it says nothing in UTF-8 (RFC 8259, section 8.1, lets readers ignore it).
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if is_utf16(bytes) {
        return Err(Error::new(kind, format!("{name}: the text is in UTF-16, UTF-8 is needed")));
    }
    serde_json::from_slice::<Unique>(bytes).map(|Unique(value)| value).map_err(|e| {
        let text = if e.is_data() {
            format!("{name}: {e}") // a key twice
        } else {
            let key = last_key(bytes, e.line(), e.column());
            let after = key.map_or(String::new(), |key| format!(" (after {key:?})"));
            format!("{name}: not JSON: {e}{after}")
        };
        Error::new(kind, text).with_source(e)
    })
}

/// A byte order mark of UTF-16 or UTF-32, or the zero that is half of the first letter.
fn is_utf16(bytes: &[u8]) -> bool {
    match bytes {
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => true,
        [first, second, ..] => (*first == 0) != (*second == 0),
        _ => false,
    }
}

/// The last key before a syntax error. `NaN` and `1e999` are syntax errors, and the field is what a user looks for.
fn last_key(bytes: &[u8], line: usize, column: usize) -> Option<String> {
    let mut line_start = 0;
    for _ in 1..line {
        line_start += bytes.get(line_start..)?.iter().position(|b| *b == b'\n')? + 1;
    }
    let before = bytes.get(..(line_start + column).min(bytes.len()))?;
    let before =
        before.get(..before.iter().rposition(|b| *b == b':')?)?.trim_ascii_end().strip_suffix(b"\"")?;
    let key = before.get(before.iter().rposition(|b| *b == b'"')? + 1..)?;
    Some(short(&String::from_utf8_lossy(key)))
}

/// Hostile text is quoted in messages, but not at length.
pub(super) fn short(text: &str) -> String {
    const MOST: usize = 48;
    if text.chars().count() <= MOST {
        text.to_owned()
    } else {
        text.chars().take(MOST).chain("...".chars()).collect()
    }
}

/// A value in which no object has a key twice.
struct Unique(Value);

impl<'de> Deserialize<'de> for Unique {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(UniqueKeys).map(Self)
    }
}

struct UniqueKeys;

impl<'de> Visitor<'de> for UniqueKeys {
    type Value = Value;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a JSON value")
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Value, E> {
        Ok(Value::Bool(value))
    }

    fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
        Ok(Value::from(value))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
        Ok(Value::from(value))
    }

    fn visit_f64<E>(self, value: f64) -> Result<Value, E> {
        Ok(Number::from_f64(value).map_or(Value::Null, Value::Number))
    }

    fn visit_str<E>(self, value: &str) -> Result<Value, E> {
        Ok(Value::from(value))
    }

    fn visit_string<E>(self, value: String) -> Result<Value, E> {
        Ok(Value::String(value))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Value, A::Error> {
        let mut values = Vec::new();
        while let Some(Unique(value)) = list.next_element()? {
            values.push(value);
        }
        Ok(Value::Array(values))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Value, A::Error> {
        let mut object = Map::new();
        while let Some(key) = entries.next_key::<String>()? {
            if object.contains_key(&key) {
                return Err(A::Error::custom(format_args!("the key {:?} is given twice", short(&key))));
            }
            let Unique(value) = entries.next_value()?;
            object.insert(key, value);
        }
        Ok(Value::Object(object))
    }
}

//! From bytes to typed values. `serde` says what is wrong, `serde_path_to_error` where; what both let pass is caught here: a byte order
//! mark, UTF-16, a key that is given twice, a list in the place of an object, another format or version.

use boxline::{Error, ErrorKind};
use serde::Deserialize;
use serde::de::value::MapAccessDeserializer;
use serde::de::{DeserializeOwned, Deserializer, Error as _, MapAccess, SeqAccess, Unexpected, Visitor};
use serde_json::{Map, Number, Value};
use serde_path_to_error::Track;
use std::fmt::{self, Display};
use std::marker::PhantomData;

/// Parses the bytes of a file; `name` and `kind` are for the error.
///
/// # Errors
/// Of `kind`, with `name` and the field in front: not UTF-8, not JSON, or a key twice in one object, of which a reader would take one
/// and a person may have meant the other.
pub fn parse_json(bytes: &[u8], name: &str, kind: ErrorKind) -> Result<Value, Error> {
    // Editors put it in front; it says nothing in UTF-8 (RFC 8259, section 8.1, lets readers ignore it).
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if is_utf16(bytes) {
        return Err(Error::new(kind, format!("{name}: the text is in UTF-16, UTF-8 is needed")));
    }
    let mut track = Track::new();
    let mut json = serde_json::Deserializer::from_slice(bytes);
    let value = Unique::deserialize(serde_path_to_error::Deserializer::new(&mut json, &mut track));
    // What comes after the value belongs to no field.
    let value = value
        .map_err(|e| (track.path().to_string(), e))
        .and_then(|Unique(value)| json.end().map(|()| value).map_err(|e| (ROOT.to_owned(), e)));
    value.map_err(|(path, e)| {
        let what = if e.is_data() { "" } else { "not JSON: " }; // a key twice is JSON
        field_error(kind, name, &path, format_args!("{what}{e}")).with_source(e)
    })
}

/// Reads a file of a format, or one that has no key `format`.
///
/// # Errors
/// As [`parse_json`], and where a field is missing, of the wrong type or out of range.
pub(super) fn read<T: DeserializeOwned>(
    bytes: &[u8],
    name: &str,
    kind: ErrorKind,
    format: Option<&str>,
) -> Result<T, Error> {
    let value = parse_json(bytes, name, kind)?;
    // First of all: in another kind of file, or a newer version, any field may be another.
    if let (Some(needed), Some(file)) = (format, value.as_object()) {
        let found = file.get("format").ok_or_else(|| missing(kind, name, "format"))?;
        if found != needed {
            return Err(field_error(
                kind,
                name,
                "format",
                format_args!("found {found}, {needed:?} is needed"),
            ));
        }
    }
    serde_path_to_error::deserialize(value).map(|Object(read)| read).map_err(|e| {
        let path = e.path().to_string();
        field_error(kind, name, &path, e.inner()).with_source(e.into_inner())
    })
}

/// How `serde_path_to_error` writes the path of the whole file.
const ROOT: &str = ".";

/// An error about a field.
pub(super) fn field_error(kind: ErrorKind, name: &str, path: &str, what: impl Display) -> Error {
    // A key that was not read whole has no name.
    let path = path.trim_end_matches(['?', '.']);
    let text = if path.is_empty() { what.to_string() } else { format!("{path}: {what}") };
    Error::new(kind, format!("{name}: {}", short(&text)))
}

/// The error about a field of the file itself that is not there.
pub(super) fn missing(kind: ErrorKind, name: &str, field: &str) -> Error {
    field_error(kind, name, ROOT, format_args!("missing field `{field}`"))
}

/// A byte order mark of UTF-16 or UTF-32, or the zero that is half of the first letter.
fn is_utf16(bytes: &[u8]) -> bool {
    match bytes {
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => true,
        [first, second, ..] => (*first == 0) != (*second == 0),
        _ => false,
    }
}

/// Hostile text is quoted in messages, but not at length.
fn short(text: &str) -> String {
    const ENDS: usize = 100;
    let length = text.chars().count();
    if length <= 2 * ENDS {
        return text.to_owned();
    }
    text.chars().take(ENDS).chain("...".chars()).chain(text.chars().skip(length - ENDS)).collect()
}

/// A struct that is read from an object only: derived code would take a list of its fields too.
pub(super) struct Object<T>(pub T);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Object<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(Keys(PhantomData)).map(Self)
    }
}

struct Keys<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> Visitor<'de> for Keys<T> {
    type Value = T;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, entries: A) -> Result<T, A::Error> {
        T::deserialize(MapAccessDeserializer::new(entries))
    }
}

/// A text that is not empty.
pub(super) fn text<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    let found = String::deserialize(deserializer)?;
    if found.is_empty() { Err(D::Error::invalid_value(Unexpected::Str(""), &"a text")) } else { Ok(found) }
}

/// A number above 0.
pub(super) fn positive<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let found = f64::deserialize(deserializer)?;
    if found > 0.0 {
        Ok(found)
    } else {
        Err(D::Error::invalid_value(Unexpected::Float(found), &"a positive number"))
    }
}

/// A whole number from LOW to HIGH.
pub(super) struct Within<T, const LOW: u64, const HIGH: u64>(pub T);

impl<'de, T: TryFrom<u64>, const LOW: u64, const HIGH: u64> Deserialize<'de> for Within<T, LOW, HIGH> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let found = u64::deserialize(deserializer)?;
        let whole = T::try_from(found).ok().filter(|_| (LOW..=HIGH).contains(&found));
        let wrong = || D::Error::custom(format_args!("found {found}, {LOW} to {HIGH} are allowed"));
        whole.map(Self).ok_or_else(wrong)
    }
}

/// The same without its wrapper.
pub(super) fn within<'de, D, T, const LOW: u64, const HIGH: u64>(deserializer: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: TryFrom<u64>,
{
    Within::<T, LOW, HIGH>::deserialize(deserializer).map(|Within(n)| n)
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

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
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
                return Err(A::Error::custom(format_args!("the key {key:?} is given twice")));
            }
            let Unique(value) = entries.next_value()?;
            object.insert(key, value);
        }
        Ok(Value::Object(object))
    }
}

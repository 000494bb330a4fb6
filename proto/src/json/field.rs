//! Walks a parsed JSON value and remembers the way, so that every complaint names file and field.

use super::syntax::short;
use boxline::{Error, ErrorKind};
use serde_json::Value;

/// A value inside a file, with its path (`frames[2].role`).
pub(super) struct Field<'a> {
    file: &'a str,
    kind: ErrorKind,
    path: String,
    value: &'a Value,
}

fn describe(value: &Value) -> String {
    match value {
        Value::Array(list) => format!("a list of {}", list.len()),
        Value::Object(_) => "an object".to_owned(),
        Value::String(text) => format!("{:?}", short(text)),
        other => other.to_string(),
    }
}

impl<'a> Field<'a> {
    /// The whole file.
    pub fn root(value: &'a Value, file: &'a str, kind: ErrorKind) -> Self {
        Self { file, kind, path: String::new(), value }
    }

    /// An error about this field.
    pub fn error(&self, text: impl std::fmt::Display) -> Error {
        let path = if self.path.is_empty() { "top level" } else { &self.path };
        Error::new(self.kind, format!("{}: {path}: {text}", self.file))
    }

    pub fn wrong(&self, needed: &str) -> Error {
        self.error(format_args!("found {}, {needed} is needed", describe(self.value)))
    }

    fn with(&self, path: String, value: &'a Value) -> Self {
        Self { file: self.file, kind: self.kind, path, value }
    }

    fn path_of(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) }
    }

    /// The field with this key; `None` if it is missing or null.
    pub fn optional(&self, key: &str) -> Result<Option<Self>, Error> {
        let object = self.value.as_object().ok_or_else(|| self.wrong("an object"))?;
        Ok(object.get(key).filter(|v| !v.is_null()).map(|value| self.with(self.path_of(key), value)))
    }

    /// The field with this key, which must be there.
    pub fn get(&self, key: &str) -> Result<Self, Error> {
        let object = self.value.as_object().ok_or_else(|| self.wrong("an object"))?;
        let path = self.path_of(key);
        match object.get(key) {
            Some(value) => Ok(self.with(path, value)),
            None => Err(Error::new(self.kind, format!("{}: {path}: missing", self.file))),
        }
    }

    /// Whether it has keys.
    pub fn is_object(&self) -> bool {
        self.value.is_object()
    }

    /// All keys with their fields.
    pub fn entries(&self) -> Result<Vec<(&'a str, Self)>, Error> {
        let object = self.value.as_object().ok_or_else(|| self.wrong("an object"))?;
        Ok(object.iter().map(|(key, value)| (key.as_str(), self.with(self.path_of(key), value))).collect())
    }

    /// The elements of a list of any length.
    pub fn list(&self) -> Result<Vec<Self>, Error> {
        let list = self.value.as_array().ok_or_else(|| self.wrong("a list"))?;
        Ok(list
            .iter()
            .enumerate()
            .map(|(i, value)| self.with(format!("{}[{i}]", self.path), value))
            .collect())
    }

    /// Exactly N elements, each read by `read`.
    pub fn array<T, const N: usize>(
        &self,
        read: impl Fn(&Self) -> Result<T, Error>,
    ) -> Result<[T; N], Error> {
        let items = self.list()?.iter().map(read).collect::<Result<Vec<T>, Error>>()?;
        items.try_into().map_err(|_found: Vec<T>| self.wrong(&format!("a list of {N}")))
    }

    /// A finite number.
    pub fn number(&self) -> Result<f64, Error> {
        self.value.as_f64().filter(|x| x.is_finite()).ok_or_else(|| self.wrong("a finite number"))
    }

    /// Exactly N finite numbers.
    pub fn numbers<const N: usize>(&self) -> Result<[f64; N], Error> {
        self.array(Self::number)
    }

    /// A positive finite number.
    pub fn positive(&self) -> Result<f64, Error> {
        self.number().ok().filter(|x| *x > 0.0).ok_or_else(|| self.wrong("a positive number"))
    }

    /// A whole number from 0 to 2^32 - 1.
    pub fn count(&self) -> Result<u32, Error> {
        let whole = self.value.as_u64().and_then(|x| u32::try_from(x).ok());
        whole.ok_or_else(|| self.wrong("a whole number"))
    }

    /// A truth value.
    pub fn boolean(&self) -> Result<bool, Error> {
        self.value.as_bool().ok_or_else(|| self.wrong("true or false"))
    }

    /// A text that is not empty.
    pub fn text(&self) -> Result<&'a str, Error> {
        self.value.as_str().filter(|t| !t.is_empty()).ok_or_else(|| self.wrong("a text"))
    }

    /// One of a few names.
    pub fn one_of<T: Copy>(&self, names: &[(&str, T)]) -> Result<T, Error> {
        let found = self.value.as_str().and_then(|text| names.iter().find(|(name, _)| *name == text));
        found.map(|(_, value)| *value).ok_or_else(|| {
            let quoted: Vec<_> = names.iter().map(|(name, _)| format!("{name:?}")).collect();
            self.wrong(&quoted.join(" or "))
        })
    }

    /// Checks the file's `format` key: another kind of file or a newer version is refused, not guessed at.
    pub fn check_format(&self, needed: &str) -> Result<(), Error> {
        self.get("format")?.one_of(&[(needed, ())])
    }
}

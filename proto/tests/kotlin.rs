//! The Android library reads messages by field number. Its numbers, and how it reads each field, are those of the schema.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use protox::prost_reflect::{DescriptorPool, Kind};
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

fn kotlin(name: &str) -> String {
    let folder = root().join("android/library/src/main/kotlin/dev/boxline/internal");
    std::fs::read_to_string(folder.join(name)).unwrap()
}

fn schema() -> DescriptorPool {
    let files = protox::compile(["boxline.proto"], [root().join("proto")]).unwrap();
    DescriptorPool::from_file_descriptor_set(files).unwrap()
}

/// `Field.kt` as (object, constant, number).
fn numbers(text: &str) -> Vec<(String, String, i64)> {
    let (mut object, mut found) = (String::new(), Vec::new());
    for line in text.lines().map(str::trim) {
        if let Some(name) = line.strip_prefix("object ") {
            object = name.trim_end_matches(" {").to_owned();
        } else if let Some((name, number)) = line.strip_prefix("const val ").and_then(|c| c.split_once(" = "))
        {
            found.push((object.clone(), name.to_owned(), number.trim_end_matches('L').parse().unwrap()));
        }
    }
    found
}

/// What of `text` is not in the schema.
fn differences(text: &str, schema: &DescriptorPool) -> Vec<String> {
    let number = |object: &str, name: &str| {
        let full = format!("boxline.v1.{object}");
        let field = || {
            Some(schema.get_message_by_name(&full)?.get_field_by_name(&name.to_lowercase())?.number().into())
        };
        let value = || Some(schema.get_enum_by_name(&full)?.get_value_by_name(name)?.number().into());
        field().or_else(value)
    };
    let all = numbers(text).into_iter().map(|(object, name, is)| (number(&object, &name), object, name, is));
    all.filter(|(due, .., is)| *due != Some(*is))
        .map(|(due, object, name, is)| format!("{object}.{name} is {is}, the schema has {due:?}"))
        .collect()
}

#[test]
fn numbers_are_those_of_the_schema() {
    let (text, schema) = (kotlin("Field.kt"), schema());
    assert!(numbers(&text).len() > 50, "Field.kt is written in another way than this test reads");
    assert_eq!(differences(&text, &schema), Vec::<String>::new());
    let changed = text.replacen("const val FACES = 5", "const val FACES = 6", 1);
    assert_eq!(differences(&changed, &schema), ["BoxReport.FACES is 6, the schema has Some(5)"]);
}

#[test]
fn fields_are_read_by_name_and_as_what_they_are() {
    let (text, schema) = (kotlin("Reports.kt"), schema());
    let mut read = 0;
    for part in text.split('.') {
        // `number(1)`: by a number that nothing compares.
        let bare = part.split_once('(').filter(|(_, rest)| rest.starts_with(|c: char| c.is_ascii_digit()));
        assert!(bare.is_none(), "Reports.kt reads {part:?}");
    }
    for (before, after) in
        text.match_indices("(Field.").map(|(at, sign)| (&text[..at], &text[at + sign.len()..]))
    {
        let how = before.rsplit('.').next().unwrap();
        let path = after.split_once(|c: char| c != '.' && c != '_' && !c.is_alphanumeric()).unwrap().0;
        let (object, name) = path.split_once('.').unwrap();
        let field = schema.get_message_by_name(&format!("boxline.v1.{object}")).unwrap();
        let field = field.get_field_by_name(&name.to_lowercase()).unwrap();
        let due: &[&str] = match field.kind() {
            Kind::Message(_) if field.is_list() => &["messages"],
            Kind::Message(_) => &["part", "message"],
            Kind::String => &["text"],
            Kind::Double if field.supports_presence() => &["doubleOrNull"],
            Kind::Double => &["double"],
            _ => &["number"],
        };
        assert!(due.contains(&how), "{path} is read as {how}, {due:?} is needed");
        read += 1;
    }
    assert!(read > 40, "{read} fields are read");
}

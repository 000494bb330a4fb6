//! Small networks of one operator each, made here, against the operator as ONNX describes it; and against ONNX Runtime where a test knows it.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use super::Plan;
use crate::onnx::{Attribute, Dim, Graph, Kind, Model, Node, Opset, Shape, Tensor, TensorKind, ValueInfo};
use boxline::{Error, ErrorKind};
use prost::Message;

/// An input or output.
fn info(name: &str, sizes: &[usize]) -> ValueInfo {
    let dims = sizes.iter().map(|size| Dim { size: Some(*size as i64) }).collect();
    let tensor = TensorKind { data_type: 1, shape: Some(Shape { dims }) };
    ValueInfo { name: name.into(), kind: Some(Kind { tensor: Some(tensor) }) }
}

fn floats(name: &str, sizes: &[usize], values: &[f32]) -> Tensor {
    let dims = sizes.iter().map(|size| *size as i64).collect();
    let raw = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    Tensor { dims, data_type: 1, name: name.into(), raw, ..Tensor::default() }
}

fn whole(name: &str, values: &[i64]) -> Tensor {
    Tensor {
        dims: vec![values.len() as i64],
        data_type: 7,
        name: name.into(),
        ints: values.to_vec(),
        ..Tensor::default()
    }
}

fn node(operator: &str, inputs: &[&str], output: &str, attributes: Vec<Attribute>) -> Node {
    Node {
        inputs: inputs.iter().map(|name| (*name).into()).collect(),
        outputs: vec![output.into()],
        operator: operator.into(),
        attributes,
        domain: String::new(),
    }
}

fn int(name: &str, int: i64) -> Attribute {
    Attribute { name: name.into(), int, ..Attribute::default() }
}

fn ints(name: &str, ints: &[i64]) -> Attribute {
    Attribute { name: name.into(), ints: ints.to_vec(), ..Attribute::default() }
}

fn text(name: &str, text: &str) -> Attribute {
    Attribute { name: name.into(), text: text.into(), ..Attribute::default() }
}

/// From `in` to `out`.
fn model(input: [usize; 4], output: [usize; 4], nodes: Vec<Node>, weights: Vec<Tensor>) -> Vec<u8> {
    let graph =
        Graph { nodes, weights, inputs: vec![info("in", &input)], outputs: vec![info("out", &output)] };
    Model { graph: Some(graph), opsets: vec![Opset { domain: String::new(), version: 17 }] }.encode_to_vec()
}

/// Numbers between -1 and 1, each another.
fn picture(sizes: [usize; 4]) -> Vec<f32> {
    let count: usize = sizes.iter().product();
    (0..count).map(|n| ((n * 7919) % 2003) as f32 / 1001.5 - 1.0).collect()
}

fn ran(input: [usize; 4], output: [usize; 4], nodes: Vec<Node>, weights: Vec<Tensor>) -> Vec<f32> {
    let plan = Plan::load(&model(input, output, nodes, weights), input[1], 1).unwrap();
    assert_eq!(plan.shapes(), [input, output]);
    let first = plan.run(&picture(input));
    assert_eq!(plan.run(&picture(input)), first, "a second run gives the same");
    first
}

fn refused(input: [usize; 4], output: [usize; 4], nodes: Vec<Node>, weights: Vec<Tensor>) -> Error {
    let error = Plan::load(&model(input, output, nodes, weights), input[1], 1).err().unwrap();
    assert_eq!(error.kind(), ErrorKind::ModelFile, "{error}");
    error
}

const SIZES: [usize; 4] = [1, 3, 4, 6];

/// The value of [`SIZES`] at a place.
fn at(values: &[f32], c: usize, y: usize, x: usize) -> f32 {
    values[(c * 4 + y) * 6 + x]
}

#[test]
fn a_slice_takes_places_forwards_and_backwards() {
    let constants = || {
        vec![
            whole("s", &[-1, 1]),
            whole("e", &[i64::MIN, i64::MAX]),
            whole("a", &[3, 2]),
            whole("t", &[-2, 1]),
        ]
    };
    let found = ran(
        SIZES,
        [1, 3, 3, 3],
        vec![node("Slice", &["in", "s", "e", "a", "t"], "out", vec![])],
        constants(),
    );
    let input = picture(SIZES);
    for (n, found) in found.iter().enumerate() {
        assert_eq!(*found, at(&input, n / 9, 1 + n / 3 % 3, 5 - 2 * (n % 3)), "place {n}");
    }
}

#[test]
fn a_transposition_moves_axes() {
    let found = ran(
        SIZES,
        [1, 6, 3, 4],
        vec![node("Transpose", &["in"], "out", vec![ints("perm", &[0, 3, 1, 2])])],
        vec![],
    );
    let input = picture(SIZES);
    for (n, found) in found.iter().enumerate() {
        assert_eq!(*found, at(&input, n / 4 % 3, n % 4, n / 12), "place {n}");
    }
}

#[test]
fn parts_of_a_split_are_joined_in_another_order() {
    let mut split = node("Split", &["in"], "a", vec![int("axis", 3)]);
    split.outputs = vec!["a".into(), "b".into()];
    let nodes = vec![split, node("Concat", &["b", "in", "a"], "out", vec![int("axis", -1)])];
    let found = ran(SIZES, [1, 3, 4, 12], nodes, vec![]);
    let input = picture(SIZES);
    for (n, found) in found.iter().enumerate() {
        let x = [3, 4, 5, 0, 1, 2, 3, 4, 5, 0, 1, 2][n % 12];
        assert_eq!(*found, at(&input, n / 48, n / 12 % 4, x), "place {n}");
    }
}

#[test]
fn axes_are_added_up_averaged_and_searched() {
    let input = picture(SIZES);
    let column = |c: usize, x: usize| (0..4).map(move |y| (c, y, x));
    for operator in ["ReduceSum", "ReduceMean", "ReduceMax"] {
        // Since version 13 a sum has its axes as an input, the others have an attribute.
        let (inputs, attributes) = if operator == "ReduceSum" {
            (vec!["in", "axes"], vec![])
        } else {
            (vec!["in"], vec![ints("axes", &[-2])])
        };
        let found = ran(
            SIZES,
            [1, 3, 1, 6],
            vec![node(operator, &inputs, "out", attributes)],
            vec![whole("axes", &[2])],
        );
        for (n, found) in found.iter().enumerate() {
            let values = column(n / 6, n % 6).map(|(c, y, x)| at(&input, c, y, x));
            let due = match operator {
                "ReduceSum" => values.sum(),
                "ReduceMean" => values.sum::<f32>() / 4.0,
                _ => values.fold(f32::MIN, f32::max),
            };
            assert!((found - due).abs() < 1e-6, "{operator} {n}: {found}, {due} is due");
        }
    }
}

#[test]
fn a_softmax_sums_to_one_along_its_axis() {
    for axis in 1..4 {
        let found = ran(SIZES, SIZES, vec![node("Softmax", &["in"], "out", vec![int("axis", axis)])], vec![]);
        let input = picture(SIZES);
        for n in 0..found.len() {
            let place = [n / 24, n / 6 % 4, n % 6];
            let along = (0..SIZES[axis as usize]).map(|k| {
                let mut other = place;
                other[axis as usize - 1] = k;
                f64::from(at(&input, other[0], other[1], other[2])).exp()
            });
            let due = f64::from(input[n]).exp() / along.sum::<f64>();
            assert!((f64::from(found[n]) - due).abs() < 1e-6, "axis {axis}, place {n}");
        }
    }
}

#[test]
fn two_arrays_meet_where_one_is_repeated() {
    let input = picture(SIZES);
    let row = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
    let channel = [1.0, -2.0, 0.5];
    for (operator, f) in [
        ("Add", (|a, b| a + b) as fn(f32, f32) -> f32),
        ("Sub", |a, b| a - b),
        ("Mul", |a, b| a * b),
        ("Div", |a, b| a / b),
    ] {
        let nodes = vec![
            node(operator, &["in", "row"], "x", vec![]),
            node(operator, &["channel", "x"], "out", vec![]),
        ];
        let found = ran(
            SIZES,
            SIZES,
            nodes,
            vec![floats("row", &[6], &row), floats("channel", &[3, 1, 1], &channel)],
        );
        for (n, found) in found.iter().enumerate() {
            let due = f(channel[n / 24], f(input[n], row[n % 6]));
            assert!((found - due).abs() <= 1e-6 * due.abs(), "{operator} {n}: {found}, {due} is due");
        }
    }
}

#[test]
fn pictures_grow_by_nearest_and_between() {
    let input = picture(SIZES);
    let scales = || vec![floats("scales", &[4], &[1.0, 1.0, 3.0, 2.0])];
    let grown = |mode: &str, place: &str| {
        let attributes = vec![
            text("mode", mode),
            text("coordinate_transformation_mode", place),
            text("nearest_mode", "floor"),
        ];
        ran(SIZES, [1, 3, 12, 12], vec![node("Resize", &["in", "", "scales"], "out", attributes)], scales())
    };
    let (nearest, linear) = (grown("nearest", "asymmetric"), grown("linear", "half_pixel"));
    for n in 0..nearest.len() {
        let (c, y, x) = (n / 144, n / 12 % 12, n % 12);
        assert_eq!(nearest[n], at(&input, c, y / 3, x / 2), "place {n}");
        let (fy, fx) =
            (((y as f32 + 0.5) / 3.0 - 0.5).clamp(0.0, 3.0), ((x as f32 + 0.5) / 2.0 - 0.5).clamp(0.0, 5.0));
        let mut due = 0.0;
        for row in 0..4 {
            for column in 0..6 {
                let weight = |f: f32, n: usize| (1.0 - (f - n as f32).abs()).max(0.0);
                due += weight(fy, row) * weight(fx, column) * at(&input, c, row, column);
            }
        }
        assert!((linear[n] - due).abs() < 1e-5, "place {n}: {}, {due} is due", linear[n]);
    }
}

#[test]
fn a_picture_twice_as_large_is_made_where_no_convolution_takes_it_in() {
    let attributes =
        vec![text("coordinate_transformation_mode", "asymmetric"), text("nearest_mode", "floor")];
    let nodes = vec![node("Resize", &["in", "", "scales"], "out", attributes)];
    let found = ran(SIZES, [1, 3, 8, 12], nodes, vec![floats("scales", &[4], &[1.0, 1.0, 2.0, 2.0])]);
    let input = picture(SIZES);
    for (n, found) in found.iter().enumerate() {
        assert_eq!(*found, at(&input, n / 96, n / 12 % 8 / 2, n % 12 / 2), "place {n}");
    }
}

#[test]
fn sums_relu_and_growth_go_into_the_convolution_before_them() {
    // A point that doubles, another that turns the sign, of the half picture, which grows again.
    let weights = || {
        vec![
            floats("two", &[3, 3, 1, 1], &[2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 2.0]),
            floats("minus", &[3, 3, 1, 1], &[-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0]),
            floats("scales", &[4], &[1.0, 1.0, 2.0, 2.0]),
        ]
    };
    let nearest = vec![
        text("mode", "nearest"),
        text("coordinate_transformation_mode", "asymmetric"),
        text("nearest_mode", "floor"),
    ];
    let nodes = |wanted_elsewhere: bool| {
        vec![
            node("Conv", &["in", "two"], "a", vec![]),
            node("Conv", &["in", "minus"], "b", vec![ints("strides", &[2, 2])]),
            node("Resize", &["b", "", "scales"], "c", nearest.clone()),
            node("Add", &["c", "a"], "d", vec![]),
            node("Relu", &["d"], "e", vec![]),
            node("Add", &["e", if wanted_elsewhere { "a" } else { "in" }], "out", vec![]),
        ]
    };
    let input = picture(SIZES);
    for wanted_elsewhere in [false, true] {
        let found = ran(SIZES, SIZES, nodes(wanted_elsewhere), weights());
        for (n, found) in found.iter().enumerate() {
            let (c, y, x) = (n / 24, n / 6 % 4, n % 6);
            let own = input[n];
            let sum = 2.0 * own - at(&input, c, y / 2 * 2, x / 2 * 2);
            let due = sum.max(0.0) + if wanted_elsewhere { 2.0 * own } else { own };
            assert!((found - due).abs() < 1e-5, "place {n}: {found}, {due} is due");
        }
    }
}

#[test]
fn what_the_engine_does_not_know_is_named() {
    let unknown = refused(SIZES, SIZES, vec![node("Gelu", &["in"], "out", vec![])], vec![]);
    assert!(
        unknown.to_string().contains("Gelu") && unknown.to_string().contains("ONNX Runtime can run"),
        "{unknown}"
    );
    let grouped = vec![node("Conv", &["in", "w"], "out", vec![int("group", 3)])];
    let grouped = refused(SIZES, SIZES, grouped, vec![floats("w", &[3, 1, 1, 1], &[1.0; 3])]);
    assert!(grouped.to_string().contains("groups"), "{grouped}");
    let nobody = refused(SIZES, SIZES, vec![node("Relu", &["other"], "out", vec![])], vec![]);
    assert!(nobody.to_string().contains("\"other\""), "{nobody}");
    let sizes = refused(SIZES, [1, 3, 4, 5], vec![node("Relu", &["in"], "out", vec![])], vec![]);
    assert!(sizes.to_string().contains("[1, 3, 4, 5]"), "{sizes}");
}

#[test]
fn sizes_of_a_hostile_file_take_no_memory() {
    let conv = |attributes| vec![node("Conv", &["in", "w"], "out", attributes)];
    let weights = |sizes: &[usize], count| vec![floats("w", sizes, &vec![1.0; count])];
    for attributes in [
        vec![ints("pads", &[i64::MAX; 4])],
        vec![ints("pads", &[-1; 4])],
        vec![ints("strides", &[0, 0])],
        vec![ints("strides", &[1])],
        vec![ints("dilations", &[i64::MAX, 1])],
        vec![ints("pads", &[4096; 4])],
    ] {
        refused(SIZES, SIZES, conv(attributes), weights(&[3, 3, 2, 2], 36));
    }
    // Sizes that the values do not have, and more than can be.
    refused(SIZES, SIZES, conv(vec![]), weights(&[3, 3, 2, 2], 35));
    refused(SIZES, SIZES, conv(vec![]), weights(&[1 << 40, 1 << 40], 1));
    for wanted in [&[1 << 40, 3, 4, 6][..], &[1 << 20, 3, 4, 6], &[-1, 3, 4, 6], &[0, 3, 4, 6]] {
        refused(SIZES, SIZES, vec![node("Expand", &["in", "s"], "out", vec![])], vec![whole("s", wanted)]);
        refused(SIZES, SIZES, vec![node("ConstantOfShape", &["s"], "out", vec![])], vec![whole("s", wanted)]);
    }
    // Nothing, behind which sizes may be anything.
    for operator in ["Transpose", "Relu", "Softmax", "ReduceSum", "MaxPool", "Slice"] {
        let nodes = vec![node(operator, &["none", "s", "s"], "out", vec![ints("kernel_shape", &[1, 1])])];
        let none =
            Tensor { dims: vec![0, 1, 1 << 24, 1], data_type: 1, name: "none".into(), ..Tensor::default() };
        refused(SIZES, SIZES, nodes, vec![none, whole("s", &[0])]);
    }
    refused(SIZES, SIZES, vec![], weights(&[0, 1 << 62, 1 << 62], 0));
    let scales = vec![floats("scales", &[4], &[1.0, 1.0, 1e9, 1e9])];
    let nearest = vec![text("coordinate_transformation_mode", "asymmetric"), text("nearest_mode", "floor")];
    refused(SIZES, SIZES, vec![node("Resize", &["in", "", "scales"], "out", nearest)], scales);
}

//! The operators: what each of ONNX's nodes becomes.

use super::build::{Builder, Content, ConvDraft, Kind, NodeResult, Outcome, Value, wrong};
use super::conv::Window;
use super::len_of;
use super::ops::{BinaryOp, LinearSample, Op, Reduce, UnaryOp};
use super::sizes::{all_of, axis_of, lanes, places, size_of, spread, spread_places, spread_sizes, steps_of};
use crate::onnx::{Attribute, Data, FLOAT, Node, bad};

/// Largest kernel, step or padding.
const MOST_REACH: i64 = 4096;

/// Attributes of a node.
struct Attributes<'a>(&'a [Attribute]);

impl<'a> Attributes<'a> {
    fn find(&self, name: &str) -> Option<&'a Attribute> {
        self.0.iter().find(|a| a.name == name)
    }

    fn int(&self, name: &str, otherwise: i64) -> i64 {
        self.find(name).map_or(otherwise, |a| a.int)
    }

    fn float(&self, name: &str, otherwise: f32) -> f32 {
        self.find(name).map_or(otherwise, |a| a.float)
    }

    fn text(&self, name: &str, otherwise: &str) -> String {
        self.find(name).map_or(otherwise.into(), |a| String::from_utf8_lossy(&a.text).into_owned())
    }

    /// Numbers that say how far a window reaches: as many as `count`, each from `least` on.
    fn reaches(&self, name: &str, otherwise: i64, count: usize, least: i64) -> Outcome<Vec<usize>> {
        let values = self.find(name).map_or_else(|| vec![otherwise; count], |a| a.ints.clone());
        let sizes =
            values.iter().filter(|v| (least..=MOST_REACH).contains(*v)).map(|v| v.unsigned_abs() as usize);
        let sizes: Vec<usize> = sizes.collect();
        if sizes.len() != count || values.len() != count {
            return wrong(format!("its {name} are {values:?}"));
        }
        Ok(sizes)
    }
}

impl Builder {
    pub(super) fn split(&mut self, node: &Node, inputs: &[Option<Value>]) -> Outcome<Vec<Value>> {
        let input = needed(inputs, 0)?;
        let axis = axis_of(Attributes(&node.attributes).int("axis", 0), input.sizes.len())?;
        let parts = match inputs.get(1).and_then(Option::as_ref) {
            Some(parts) => parts.whole()?.iter().map(|part| size_of(*part)).collect::<Outcome<Vec<_>>>()?,
            None => vec![input.sizes[axis] / node.outputs.len().max(1); node.outputs.len()],
        };
        let mut at = 0;
        let mut given = Vec::new();
        for part in parts {
            let end = at + part.min(input.sizes[axis] + 1);
            if end > input.sizes[axis] {
                return wrong("its parts are more than the whole");
            }
            let mut picks = all_of(&input.sizes);
            picks[axis] = (at..end).collect();
            given.push(self.picked(input, &picks)?);
            at = end;
        }
        Ok(given)
    }

    fn picked(&mut self, input: &Value, picks: &[Vec<usize>]) -> Outcome<Value> {
        let NodeResult::Step(kind, inputs, sizes) = picked(input, picks)? else {
            return wrong("nothing is picked");
        };
        self.step(kind, inputs, sizes)
    }

    /// What a node of one output gives.
    pub(super) fn given(&mut self, node: &Node, inputs: &[Option<Value>]) -> Outcome<NodeResult> {
        let attributes = &Attributes(&node.attributes);
        match node.operator.as_str() {
            "Constant" => {
                let tensor = attributes.find("value").and_then(|a| a.tensor.clone());
                self.array(tensor.ok_or_else(|| bad("it has no value"))?).map(NodeResult::Ready)
            }
            "Conv" => conv(inputs, attributes),
            "Gemm" => product(inputs, attributes),
            "MaxPool" => max_pool(needed(inputs, 0)?, attributes),
            "Resize" => resize(inputs, attributes),
            "Relu" => each(inputs, UnaryOp::Relu),
            "Sigmoid" => each(inputs, UnaryOp::Sigmoid),
            "Sqrt" => each(inputs, UnaryOp::Sqrt),
            "Abs" => each(inputs, UnaryOp::Abs),
            "Clip" => clip(inputs),
            "Add" => pair(BinaryOp::Add, inputs),
            "Sub" => pair(BinaryOp::Sub, inputs),
            "Mul" => pair(BinaryOp::Mul, inputs),
            "Div" => pair(BinaryOp::Div, inputs),
            "Pow" => pair(BinaryOp::Pow, inputs),
            "Equal" => self.equal(inputs),
            "Where" => self.chosen(inputs),
            "ConstantOfShape" => self.constant_of_shape(inputs, attributes),
            "Shape" => shape(inputs, attributes),
            "Expand" => self.expand(inputs),
            "Transpose" => transpose(inputs, attributes),
            "Slice" => slice(inputs),
            "Gather" => gather(inputs, attributes),
            "Concat" => concat(inputs, attributes),
            "ReduceMean" => reduce(Reduce::Mean, inputs, attributes),
            "ReduceSum" => reduce(Reduce::Sum, inputs, attributes),
            "ReduceMax" => reduce(Reduce::Max, inputs, attributes),
            "Softmax" => softmax(inputs, attributes),
            "Identity" => seen_as(inputs, needed(inputs, 0)?.sizes.clone()),
            "Cast" => cast(inputs, attributes),
            "Reshape" => reshape(inputs, attributes),
            "Flatten" => flatten(inputs, attributes),
            "Squeeze" => squeeze(inputs, attributes),
            "Unsqueeze" => unsqueeze(inputs, attributes),
            _ => wrong("the engine inside does not know it; ONNX Runtime can run the network"),
        }
    }

    fn equal(&mut self, inputs: &[Option<Value>]) -> Outcome<NodeResult> {
        let (a, b) = (needed(inputs, 0)?, needed(inputs, 1)?);
        let sizes = spread_sizes(&a.sizes, &b.sizes)?;
        self.count(&sizes)?;
        let (first, second) = (spread_places(&a.sizes, &sizes), spread_places(&b.sizes, &sizes));
        let (a, b) = (a.whole()?, b.whole()?);
        let same = first.iter().zip(&second).map(|(x, y)| i64::from(a[*x as usize] == b[*y as usize]));
        Ok(NodeResult::Ready(Value::known(sizes, Data::Whole(same.collect()))))
    }

    fn chosen(&mut self, inputs: &[Option<Value>]) -> Outcome<NodeResult> {
        let values = [needed(inputs, 0)?, needed(inputs, 1)?, needed(inputs, 2)?];
        let sizes = spread_sizes(&spread_sizes(&values[0].sizes, &values[1].sizes)?, &values[2].sizes)?;
        let len = self.count(&sizes)?;
        let places = values.map(|value| spread_places(&value.sizes, &sizes));
        let [condition, yes, no] = [values[0].whole()?, values[1].whole()?, values[2].whole()?];
        let at = |values: &[i64], number: usize, n: usize| values[places[number][n] as usize];
        let one = |n| if at(condition, 0, n) == 0 { at(no, 2, n) } else { at(yes, 1, n) };
        Ok(NodeResult::Ready(Value::known(sizes, Data::Whole((0..len).map(one).collect()))))
    }

    fn constant_of_shape(
        &mut self,
        inputs: &[Option<Value>],
        attributes: &Attributes<'_>,
    ) -> Outcome<NodeResult> {
        let sizes = needed(inputs, 0)?.whole()?.iter().map(|s| size_of(*s)).collect::<Outcome<Vec<_>>>()?;
        let len = self.count(&sizes)?;
        let data = match attributes.find("value").and_then(|a| a.tensor.clone()) {
            None => Data::Floats(vec![0.0; len]),
            Some(tensor) => match tensor.contents()?.1 {
                Data::Floats(values) if values.len() == 1 => Data::Floats(vec![values[0]; len]),
                Data::Whole(values) if values.len() == 1 => Data::Whole(vec![values[0]; len]),
                _ => return wrong("its value is no single number"),
            },
        };
        Ok(NodeResult::Ready(Value::known(sizes, data)))
    }

    fn expand(&mut self, inputs: &[Option<Value>]) -> Outcome<NodeResult> {
        let wanted = needed(inputs, 1)?.whole()?.iter().map(|s| size_of(*s)).collect::<Outcome<Vec<_>>>()?;
        let sizes = spread_sizes(&needed(inputs, 0)?.sizes, &wanted)?;
        self.count(&sizes)?;
        let places = spread_places(&needed(inputs, 0)?.sizes, &sizes);
        Ok(NodeResult::Step(Kind::Other(Op::Take(places)), vec![needed(inputs, 0)?.clone()], sizes))
    }
}

/// Axes are an attribute of older versions, an input of newer ones.
fn axes(inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<Option<Vec<i64>>> {
    match (inputs.get(1).and_then(Option::as_ref), attributes.find("axes")) {
        (Some(axes), _) => axes.whole().map(|a| Some(a.to_vec())),
        (None, Some(attribute)) => Ok(Some(attribute.ints.clone())),
        (None, None) => Ok(None),
    }
}

fn each(inputs: &[Option<Value>], kind: UnaryOp) -> Outcome<NodeResult> {
    let input = needed(inputs, 0)?;
    Ok(NodeResult::Step(Kind::Other(Op::Unary(kind)), vec![input.clone()], input.sizes.clone()))
}

/// The first input's numbers as an array of other sizes.
fn seen_as(inputs: &[Option<Value>], sizes: Vec<usize>) -> Outcome<NodeResult> {
    let input = needed(inputs, 0)?;
    if len_of(&sizes) != len_of(&input.sizes) {
        return wrong(format!("{:?} cannot be seen as {sizes:?}", input.sizes));
    }
    Ok(NodeResult::Ready(Value { sizes, content: input.content.clone() }))
}

fn clip(inputs: &[Option<Value>]) -> Outcome<NodeResult> {
    let bound = |n: usize, otherwise: f32| match inputs
        .get(n)
        .and_then(Option::as_ref)
        .map(Value::floats)
        .transpose()?
        .as_deref()
    {
        Some(Data::Floats(values)) if values.len() == 1 => Ok(values[0]),
        None => Ok(otherwise),
        _ => wrong("its bounds are no single numbers"),
    };
    each(inputs, UnaryOp::Clip(bound(1, f32::NEG_INFINITY)?, bound(2, f32::INFINITY)?))
}

fn gather(inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    let (input, chosen) = (needed(inputs, 0)?, needed(inputs, 1)?);
    let axis = axis_of(attributes.int("axis", 0), input.sizes.len())?;
    if chosen.sizes.len() > 1 {
        return wrong("it chooses by more than a row of numbers");
    }
    let mut picks = all_of(&input.sizes);
    picks[axis] =
        chosen.whole()?.iter().map(|n| axis_of(*n, input.sizes[axis])).collect::<Outcome<Vec<_>>>()?;
    let NodeResult::Step(kind, inputs, mut sizes) = picked(input, &picks)? else {
        return wrong("nothing is picked");
    };
    if chosen.sizes.is_empty() {
        sizes.remove(axis);
    }
    Ok(NodeResult::Step(kind, inputs, sizes))
}

fn transpose(inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    let input = needed(inputs, 0)?;
    let rank = input.sizes.len();
    let order = attributes.find("perm").map_or_else(|| (0..rank as i64).rev().collect(), |a| a.ints.clone());
    let order = order.iter().map(|axis| axis_of(*axis, rank)).collect::<Outcome<Vec<_>>>()?;
    if order.len() != rank || !(0..rank).all(|axis| order.contains(&axis)) {
        return wrong(format!("its order is {order:?}"));
    }
    let steps = steps_of(&input.sizes);
    let sizes: Vec<usize> = order.iter().map(|axis| input.sizes[*axis]).collect();
    let steps: Vec<usize> = order.iter().map(|axis| steps[*axis]).collect();
    let places = places(&all_of(&sizes), &steps);
    Ok(NodeResult::Step(Kind::Other(Op::Take(places)), vec![input.clone()], sizes))
}

fn reduce(kind: Reduce, inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    let input = needed(inputs, 0)?;
    let rank = input.sizes.len();
    let axes = axes(inputs, attributes)?.unwrap_or_else(|| (0..rank as i64).collect());
    let axes = axes.iter().map(|axis| axis_of(*axis, rank)).collect::<Outcome<Vec<_>>>()?;
    if attributes.int("noop_with_empty_axes", 0) != 0 {
        return wrong("the engine inside knows no sum that sums nothing; ONNX Runtime can run it");
    }
    let lanes = lanes(&input.sizes, &axes)?;
    let keep = attributes.int("keepdims", 1) != 0;
    let sizes = input.sizes.iter().enumerate().filter_map(|(axis, size)| match axes.contains(&axis) {
        true => keep.then_some(1),
        false => Some(*size),
    });
    let sizes = sizes.collect();
    Ok(NodeResult::Step(Kind::Other(Op::Reduce { kind, lanes }), vec![input.clone()], sizes))
}

fn softmax(inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    let input = needed(inputs, 0)?;
    let lanes = lanes(&input.sizes, &[axis_of(attributes.int("axis", -1), input.sizes.len())?])?;
    Ok(NodeResult::Step(Kind::Other(Op::Softmax(lanes)), vec![input.clone()], input.sizes.clone()))
}

fn shape(inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    if attributes.find("start").is_some() || attributes.find("end").is_some() {
        return wrong("the engine inside knows it without start and end only; ONNX Runtime can run it");
    }
    let sizes: Vec<i64> =
        needed(inputs, 0)?.sizes.iter().map(|s| i64::try_from(*s).unwrap_or(i64::MAX)).collect();
    Ok(NodeResult::Ready(Value::known(vec![sizes.len()], Data::Whole(sizes))))
}

fn cast(inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    let is_float = match &needed(inputs, 0)?.content {
        Content::Known(data) => matches!(**data, Data::Floats(_)),
        Content::Made(_) => true,
    };
    if !is_float || attributes.int("to", 0) != i64::from(FLOAT) {
        return wrong("the engine inside casts from floats to floats only; ONNX Runtime can run it");
    }
    seen_as(inputs, needed(inputs, 0)?.sizes.clone())
}

fn reshape(inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    let input = needed(inputs, 0)?;
    let wanted = needed(inputs, 1)?.whole()?;
    if wanted.iter().filter(|size| **size == -1).count() > 1 || attributes.int("allowzero", 0) != 0 {
        return wrong(format!("its sizes are {wanted:?}"));
    }
    let mut sizes = Vec::new();
    for (axis, size) in wanted.iter().enumerate() {
        sizes.push(match size {
            0 => *input.sizes.get(axis).ok_or_else(|| bad(format!("its sizes are {wanted:?}")))?,
            -1 => 1,
            size => size_of(*size)?,
        });
    }
    if let Some(axis) = wanted.iter().position(|size| *size == -1) {
        let others = len_of(&sizes).filter(|len| *len > 0);
        let others = others.ok_or_else(|| bad(format!("its sizes are {wanted:?}")))?;
        sizes[axis] = input.sizes.iter().product::<usize>() / others;
    }
    seen_as(inputs, sizes)
}

fn flatten(inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    let sizes = &needed(inputs, 0)?.sizes;
    let axis = attributes.int("axis", 1);
    let axis =
        if usize::try_from(axis) == Ok(sizes.len()) { sizes.len() } else { axis_of(axis, sizes.len())? };
    seen_as(inputs, vec![sizes[..axis].iter().product(), sizes[axis..].iter().product()])
}

fn squeeze(inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    let sizes = &needed(inputs, 0)?.sizes;
    let rank = sizes.len();
    let dropped = match axes(inputs, attributes)? {
        Some(axes) => axes.iter().map(|axis| axis_of(*axis, rank)).collect::<Outcome<Vec<_>>>()?,
        None => (0..rank).filter(|axis| sizes[*axis] == 1).collect(),
    };
    seen_as(inputs, (0..rank).filter(|axis| !dropped.contains(axis)).map(|axis| sizes[axis]).collect())
}

fn unsqueeze(inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    let added = axes(inputs, attributes)?.ok_or_else(|| bad("it has no axes"))?;
    let rank = needed(inputs, 0)?.sizes.len() + added.len();
    let added = added.iter().map(|axis| axis_of(*axis, rank)).collect::<Outcome<Vec<_>>>()?;
    let mut old = needed(inputs, 0)?.sizes.iter();
    let sizes = (0..rank).map(|axis| if added.contains(&axis) { Some(1) } else { old.next().copied() });
    seen_as(inputs, sizes.collect::<Option<Vec<_>>>().ok_or_else(|| bad("its axes are named twice"))?)
}

fn needed(inputs: &[Option<Value>], number: usize) -> Outcome<&Value> {
    inputs.get(number).and_then(Option::as_ref).ok_or_else(|| bad(format!("its input {number} is missing")))
}

fn picked(input: &Value, picks: &[Vec<usize>]) -> Outcome<NodeResult> {
    let sizes: Vec<usize> = picks.iter().map(Vec::len).collect();
    if len_of(&sizes).is_none() {
        return wrong(format!("an array of {sizes:?} is too large"));
    }
    let places = places(picks, &steps_of(&input.sizes));
    Ok(NodeResult::Step(Kind::Other(Op::Take(places)), vec![input.clone()], sizes))
}

fn pair(kind: BinaryOp, inputs: &[Option<Value>]) -> Outcome<NodeResult> {
    let (a, b) = (needed(inputs, 0)?, needed(inputs, 1)?);
    let sizes = spread_sizes(&a.sizes, &b.sizes)?;
    if len_of(&sizes).is_none() {
        return wrong(format!("an array of {sizes:?} is too large"));
    }
    let spread = [spread(&a.sizes, &sizes), spread(&b.sizes, &sizes)];
    Ok(NodeResult::Step(Kind::Other(Op::Binary { kind, spread }), vec![a.clone(), b.clone()], sizes))
}

fn slice(inputs: &[Option<Value>]) -> Outcome<NodeResult> {
    let input = needed(inputs, 0)?;
    let rank = input.sizes.len();
    let (starts, ends) = (needed(inputs, 1)?.whole()?, needed(inputs, 2)?.whole()?);
    let axes = match inputs.get(3).and_then(Option::as_ref) {
        Some(axes) => axes.whole()?.to_vec(),
        None => (0..starts.len() as i64).collect(),
    };
    let steps = match inputs.get(4).and_then(Option::as_ref) {
        Some(steps) => steps.whole()?.to_vec(),
        None => vec![1; starts.len()],
    };
    if ends.len() != starts.len() || axes.len() != starts.len() || steps.len() != starts.len() {
        return wrong("its starts, ends, axes and steps differ in number");
    }
    let mut picks = all_of(&input.sizes);
    for (((start, end), axis), step) in starts.iter().zip(ends).zip(axes).zip(steps) {
        let axis = axis_of(axis, rank)?;
        let size = i64::try_from(input.sizes[axis]).unwrap_or(i64::MAX);
        // Below 0 counts from the end; what is outside is the border.
        let counted = |n: i64| if n < 0 { n.saturating_add(size) } else { n };
        picks[axis] = if step > 0 {
            let (start, end) = (counted(*start).clamp(0, size), counted(*end).clamp(0, size));
            (start..end)
                .step_by(usize::try_from(step).unwrap_or(usize::MAX))
                .map(|n| n.unsigned_abs() as usize)
                .collect()
        } else if step < 0 {
            let (start, end) = (counted(*start).clamp(-1, size - 1), counted(*end).clamp(-1, size - 1));
            let step = usize::try_from(step.unsigned_abs()).unwrap_or(usize::MAX);
            (end + 1..start + 1).rev().step_by(step).map(|n| n.unsigned_abs() as usize).collect()
        } else {
            return wrong("its step is 0");
        };
    }
    picked(input, &picks)
}

fn concat(inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    let first = needed(inputs, 0)?;
    let axis = axis_of(attributes.int("axis", 0), first.sizes.len())?;
    let mut sizes = first.sizes.clone();
    sizes[axis] = 0;
    let (mut parts, mut values) = (Vec::new(), Vec::new());
    for number in 0..inputs.len() {
        let value = needed(inputs, number)?;
        let alike = value.sizes.len() == sizes.len()
            && value.sizes.iter().zip(&sizes).enumerate().all(|(n, (a, b))| n == axis || a == b);
        if !alike {
            return wrong(format!("arrays of {:?} and {:?} cannot be joined", first.sizes, value.sizes));
        }
        sizes[axis] += value.sizes[axis];
        parts.push(value.sizes[axis..].iter().product());
        values.push(value.clone());
    }
    Ok(NodeResult::Step(Kind::Other(Op::Join(parts)), values, sizes))
}

/// The window of a convolution or a pooling over one or two axes; one axis is a row.
fn window(attributes: &Attributes<'_>, size: &[usize]) -> Outcome<Window> {
    let axes = size.len();
    if attributes.text("auto_pad", "NOTSET") != "NOTSET" || attributes.int("ceil_mode", 0) != 0 {
        return wrong("the engine inside wants explicit padding; ONNX Runtime can run it");
    }
    let strides = attributes.reaches("strides", 1, axes, 1)?;
    let dilations = attributes.reaches("dilations", 1, axes, 1)?;
    let pads = attributes.reaches("pads", 0, 2 * axes, 0)?;
    let of = |values: &[usize], otherwise| match values {
        [columns] => Some([otherwise, *columns]),
        [rows, columns] => Some([*rows, *columns]),
        _ => None,
    };
    let pads = match pads.as_slice() {
        [left, right] => [[0, 0], [*left, *right]],
        [above, left, below, right] => [[*above, *below], [*left, *right]],
        _ => return wrong("its padding"),
    };
    match (of(size, 1), of(&strides, 1), of(&dilations, 1)) {
        (Some(size), Some(strides), Some(dilations)) => Ok(Window { size, strides, dilations, pads }),
        _ => wrong("the engine inside knows one and two axes; ONNX Runtime can run it"),
    }
}

fn conv(inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    let (input, weights) = (needed(inputs, 0)?, needed(inputs, 1)?);
    let data = weights.floats()?;
    let (&[batch, channels, ref inner @ ..], &[outputs, taken, ref size @ ..]) =
        (input.sizes.as_slice(), weights.sizes.as_slice())
    else {
        return wrong("it has no channels");
    };
    if attributes.int("group", 1) != 1 {
        return wrong("the engine inside knows it without groups only; ONNX Runtime can run it");
    }
    if batch != 1
        || taken != channels
        || inner.len() != size.len()
        || inner.len() > 2
        || len_of(size).is_none_or(|n| n == 0)
    {
        return wrong(format!("weights {:?} on an input of {:?}", weights.sizes, input.sizes));
    }
    if attributes.find("kernel_shape").is_some()
        && attributes.reaches("kernel_shape", 1, size.len(), 1)? != size
    {
        return wrong("its weights have another size than it says");
    }
    let window = window(attributes, size)?;
    let (rows, columns) = match inner {
        [columns] => (1, *columns),
        [rows, columns] => (*rows, *columns),
        _ => return wrong("the engine inside knows one and two axes; ONNX Runtime can run it"),
    };
    let sizes = [window.outputs(0, rows), window.outputs(1, columns)];
    let [Some(out_rows), Some(out_columns)] = sizes else {
        return wrong("its window is larger than its input");
    };
    if window.strip_len(channels, out_columns).is_none() {
        return wrong("its window reaches too far");
    }
    let bias = inputs.get(2).and_then(Option::as_ref);
    if bias.is_some_and(|bias| bias.sizes != [outputs]) {
        return wrong("its bias has another size than its weights");
    }
    let mut sizes = vec![1, outputs];
    sizes.extend(&[out_rows, out_columns][2 - inner.len()..]);
    let draft = ConvDraft {
        window,
        input: [channels, rows, columns],
        output: [outputs, out_rows, out_columns],
        weights: data,
        bias: bias.map(Value::floats).transpose()?,
        halved: false,
        relu: false,
    };
    Ok(NodeResult::Step(Kind::Conv(Box::new(draft)), vec![input.clone()], sizes))
}

fn product(inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    let (input, weights) = (needed(inputs, 0)?, needed(inputs, 1)?);
    let plain = attributes.float("alpha", 1.0) == 1.0
        && attributes.float("beta", 1.0) == 1.0
        && attributes.int("transA", 0) == 0
        && attributes.int("transB", 0) == 1;
    if !plain {
        return wrong("the engine inside knows it with transB and nothing else; ONNX Runtime can run it");
    }
    let (&[rows, taps], &[outputs, taken]) = (input.sizes.as_slice(), weights.sizes.as_slice()) else {
        return wrong("its inputs are no matrices");
    };
    let data = (weights.floats()?, inputs.get(2).and_then(Option::as_ref).map(Value::floats).transpose()?);
    let (Data::Floats(columns), bias) = (&*data.0, data.1.as_deref()) else {
        return wrong("its weights are no floats");
    };
    let bias = match bias {
        Some(Data::Floats(bias)) => bias.clone(),
        _ => vec![0.0; outputs],
    };
    if taps != taken || taps == 0 || bias.len() != outputs || outputs == 0 {
        return wrong(format!("weights {:?} on an input of {:?}", weights.sizes, input.sizes));
    }
    let op = Op::Product { columns: columns.clone(), bias };
    Ok(NodeResult::Step(Kind::Other(op), vec![input.clone()], vec![rows, outputs]))
}

fn max_pool(input: &Value, attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    let &[batch, channels, rows, columns] = input.sizes.as_slice() else { return wrong("it has no picture") };
    if rows == 0 || columns == 0 {
        return wrong("it has no picture");
    }
    let window = window(attributes, &attributes.reaches("kernel_shape", 1, 2, 1)?)?;
    let padded_too_far = (0..2).any(|axis| window.pads[axis].iter().any(|pad| *pad >= window.size[axis]));
    if window.dilations != [1, 1] || padded_too_far {
        return wrong("the engine inside does not know it with gaps; ONNX Runtime can run it");
    }
    let [Some(out_rows), Some(out_columns)] = [window.outputs(0, rows), window.outputs(1, columns)] else {
        return wrong("its window is larger than its input");
    };
    let op = Op::MaxPool { window, input: [rows, columns], output: [out_rows, out_columns] };
    Ok(NodeResult::Step(Kind::Other(op), vec![input.clone()], vec![batch, channels, out_rows, out_columns]))
}

fn resize(inputs: &[Option<Value>], attributes: &Attributes<'_>) -> Outcome<NodeResult> {
    let input = needed(inputs, 0)?;
    let scales = inputs.get(2).and_then(Option::as_ref).filter(|scales| scales.sizes != [0]);
    let (sizes, scales): (Vec<usize>, Vec<f32>) = if let Some(scales) = scales {
        let data = scales.floats()?;
        let Data::Floats(scales) = &*data else { return wrong("its scales are no floats") };
        let sizes = input.sizes.iter().zip(scales).map(|(size, scale)| (*size as f32 * scale) as usize);
        (sizes.collect(), scales.clone())
    } else {
        let sizes = needed(inputs, 3)?.whole()?.iter().map(|s| size_of(*s)).collect::<Outcome<Vec<_>>>()?;
        let scales = sizes.iter().zip(&input.sizes).map(|(to, from)| *to as f32 / *from as f32);
        let scales = scales.collect();
        (sizes, scales)
    };
    if input.sizes.contains(&0)
        || scales.len() != input.sizes.len()
        || !scales.iter().all(|scale| scale.is_finite() && *scale > 0.0)
    {
        return wrong(format!("its scales are {scales:?}"));
    }
    if len_of(&sizes).is_none_or(|len| len == 0) {
        return wrong(format!("an array of {sizes:?}"));
    }
    let text = |name, otherwise| attributes.text(name, otherwise);
    let mode = (text("mode", "nearest"), text("coordinate_transformation_mode", "half_pixel"));
    match (mode.0.as_str(), mode.1.as_str()) {
        ("nearest", "asymmetric") if text("nearest_mode", "round_prefer_floor") == "floor" => {
            let picks = sizes.iter().zip(&input.sizes).zip(&scales).map(|((to, from), scale)| {
                (0..*to).map(|n| ((n as f32 / scale) as usize).min(from - 1)).collect()
            });
            let picks: Vec<Vec<usize>> = picks.collect();
            let doubled = scales == [1.0, 1.0, 2.0, 2.0];
            let kind = if doubled {
                Kind::Doubled(input.sizes.clone())
            } else {
                Kind::Other(Op::Take(places(&picks, &steps_of(&input.sizes))))
            };
            Ok(NodeResult::Step(kind, vec![input.clone()], sizes))
        }
        ("linear", "half_pixel") if scales.len() == 4 && sizes[..2] == input.sizes[..2] => {
            let between = |axis: usize| -> Vec<LinearSample> {
                let last = input.sizes[axis] - 1;
                let one = |n: usize| {
                    let at = ((n as f32 + 0.5) / scales[axis] - 0.5).clamp(0.0, last as f32);
                    LinearSample {
                        first: at as usize,
                        second: (at as usize + 1).min(last),
                        share: at.fract(),
                    }
                };
                (0..sizes[axis]).map(one).collect()
            };
            let op =
                Op::Linear { rows: between(2), columns: between(3), input: [input.sizes[2], input.sizes[3]] };
            Ok(NodeResult::Step(Kind::Other(op), vec![input.clone()], sizes))
        }
        (mode, place) => {
            wrong(format!("the engine inside does not know it as {mode}, {place}; ONNX Runtime can run it"))
        }
    }
}

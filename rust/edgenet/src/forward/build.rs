//! From an ONNX file to steps. Sizes are fixed, so all that depends on nothing but sizes is worked out here, and what remains is
//! arithmetic. ReLU and addition become part of the convolution before them.

use super::conv::{Conv, Window};
use super::ops::{self, BinaryOp, Op, Spread, UnaryOp};
use super::sizes::doubled;
use super::{Plan, Source, Step, checked_shapes, len_of};
use crate::onnx::{Data, Graph, Model, Node, Tensor, bad};
use boxline::Error;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;
use std::sync::Arc;

/// Values of all arrays together, at most.
const MOST_TOGETHER: usize = 1 << 27;
/// The versions of the operators whose meaning is the one here; training exports 17.
const VERSIONS: std::ops::RangeInclusive<i64> = 13..=17;
/// Number of the network's input among the arrays.
const INPUT: usize = 0;

pub(super) type Outcome<T> = Result<T, Error>;

/// An array while the network is read.
#[derive(Clone)]
pub(super) struct Value {
    pub(super) sizes: Vec<usize>,
    pub(super) content: Content,
}

#[derive(Clone)]
pub(super) enum Content {
    Known(Rc<Data>),
    /// The number of the array that a step makes.
    Made(usize),
}

/// A step, before convolutions take others in.
struct DraftStep {
    kind: Kind,
    inputs: Vec<Content>,
    output: usize,
    len: usize,
}

pub(super) enum Kind {
    Conv(Box<ConvDraft>),
    /// Twice as many rows and columns of an array of these sizes, each value four times.
    Doubled(Vec<usize>),
    Other(Op),
    /// Was taken in.
    Gone,
}

pub(super) struct ConvDraft {
    pub(super) window: Window,
    pub(super) input: [usize; 3],
    pub(super) output: [usize; 3],
    pub(super) weights: Rc<Data>,
    pub(super) bias: Option<Rc<Data>>,
    pub(super) halved: bool,
    pub(super) relu: bool,
}

/// What a node gives, before it is known whether it can be worked out at once.
pub(super) enum NodeResult {
    Step(Kind, Vec<Value>, Vec<usize>),
    Ready(Value),
}

#[derive(Default)]
pub(super) struct Builder {
    drafts: Vec<DraftStep>,
    /// Arrays made so far, the input among them.
    made: usize,
    /// Values of all arrays so far.
    together: usize,
}

pub(super) fn plan(model: Model, channels: usize, threads: usize) -> Outcome<Plan> {
    let opset = model.opsets.iter().find(|o| is_onnx(&o.domain)).map_or(0, |o| o.version);
    let graph = model.graph.unwrap_or_default();
    let Graph { nodes, weights, inputs, outputs } = graph;
    let is_weight: BTreeSet<&str> = weights.iter().map(|w| w.name.as_str()).collect();
    let inputs: Vec<_> =
        inputs.into_iter().filter(|input| !is_weight.contains(input.name.as_str())).collect();
    let sizes = |infos: &[crate::onnx::ValueInfo]| infos.iter().map(|info| info.sizes()).collect::<Vec<_>>();
    let shapes = checked_shapes(&sizes(&inputs), &sizes(&outputs), channels)?;
    if !VERSIONS.contains(&opset) {
        let (least, most) = (VERSIONS.start(), VERSIONS.end());
        return Err(bad(format!(
            "the network's operators are of version {opset}, the engine inside knows {least} to {most}; ONNX Runtime may run it"
        )));
    }
    let mut builder = Builder { made: 1, ..Builder::default() };
    let mut names = BTreeMap::new();
    for info in &inputs {
        builder.count(&shapes[0])?;
        names.insert(info.name.clone(), Value { sizes: shapes[0].to_vec(), content: Content::Made(INPUT) });
    }
    for tensor in weights {
        let name = tensor.name.clone();
        names.insert(name, builder.array(tensor)?);
    }
    for node in nodes {
        let inputs = node.inputs.iter().map(|name| match names.get(name) {
            Some(value) => Ok(Some(value.clone())),
            None if name.is_empty() => Ok(None),
            None => Err(bad(format!("the network's {} uses {name:?}, which nothing makes", node.operator))),
        });
        let inputs = inputs.collect::<Outcome<Vec<_>>>()?;
        let given = builder
            .node(&node, &inputs)
            .map_err(|e| e.in_context(format!("operator {:?}", node.operator)))?;
        if given.len() < node.outputs.len() {
            return Err(bad(format!("the network's {} gives too little", node.operator)));
        }
        for (name, value) in node.outputs.iter().zip(given) {
            names.insert(name.clone(), value);
        }
    }
    let result = outputs.first().and_then(|output| names.get(&output.name));
    let result = result.ok_or_else(|| bad("nothing makes the network's output"))?.clone();
    if result.sizes != shapes[1] {
        let (found, said) = (&result.sizes, &shapes[1]);
        return Err(bad(format!("the network's output is {found:?}, its file says {said:?}")));
    }
    drop(names);
    builder.taken_in(&result.content);
    builder.finished(result.content, shapes, threads)
}

fn is_onnx(domain: &str) -> bool {
    domain.is_empty() || domain == "ai.onnx"
}

pub(super) fn wrong<T>(what: impl Into<String>) -> Outcome<T> {
    Err(bad(what))
}

impl Value {
    pub(super) fn known(sizes: Vec<usize>, data: Data) -> Self {
        Self { sizes, content: Content::Known(Rc::new(data)) }
    }

    pub(super) fn floats(&self) -> Outcome<Rc<Data>> {
        match &self.content {
            Content::Known(data) if matches!(**data, Data::Floats(_)) => Ok(data.clone()),
            _ => wrong(
                "an array is not known before the network runs, which the engine inside needs; ONNX Runtime can run it",
            ),
        }
    }

    pub(super) fn whole(&self) -> Outcome<&[i64]> {
        match &self.content {
            Content::Known(data) => match &**data {
                Data::Whole(values) => Ok(values),
                Data::Floats(_) => wrong("floats where whole numbers belong"),
            },
            Content::Made(_) => wrong(
                "sizes depend on the picture, which the engine inside does not know; ONNX Runtime can run it",
            ),
        }
    }
}
impl Builder {
    /// Notes an array's values and refuses too many.
    pub(super) fn count(&mut self, sizes: &[usize]) -> Outcome<usize> {
        let len = len_of(sizes).ok_or_else(|| bad(format!("an array of {sizes:?} is too large")))?;
        self.together += len;
        if self.together > MOST_TOGETHER {
            return wrong("the network's arrays are too large together");
        }
        Ok(len)
    }

    pub(super) fn array(&mut self, tensor: Tensor) -> Outcome<Value> {
        let (sizes, data) = tensor.contents()?;
        self.count(&sizes)?;
        Ok(Value::known(sizes, data))
    }

    /// The outputs of a node.
    fn node(&mut self, node: &Node, inputs: &[Option<Value>]) -> Outcome<Vec<Value>> {
        if !is_onnx(&node.domain) {
            return wrong(format!(
                "the engine inside knows no operators of {:?}; ONNX Runtime may run it",
                node.domain
            ));
        }
        if node.operator == "Split" {
            return self.split(node, inputs);
        }
        match self.given(node, inputs)? {
            NodeResult::Ready(value) => Ok(vec![value]),
            NodeResult::Step(kind, inputs, sizes) => Ok(vec![self.step(kind, inputs, sizes)?]),
        }
    }

    /// Adds a step, or does it at once if all of its inputs are known.
    pub(super) fn step(&mut self, kind: Kind, inputs: Vec<Value>, sizes: Vec<usize>) -> Outcome<Value> {
        let len = self.count(&sizes)?;
        if len == 0 || inputs.iter().any(|input| input.sizes.contains(&0)) {
            return wrong("it works on nothing or gives nothing");
        }
        let known: Option<Vec<Rc<Data>>> = inputs
            .iter()
            .map(|input| match &input.content {
                Content::Known(data) => Some(data.clone()),
                Content::Made(_) => None,
            })
            .collect();
        if let Some(known) = known {
            let op = match kind {
                Kind::Doubled(sizes) => Op::Take(doubled(&sizes)),
                Kind::Other(op) => op,
                Kind::Conv(_) | Kind::Gone => return wrong("it works on nothing but weights"),
            };
            return Ok(Value::known(sizes, at_once(&op, &known, len)?));
        }
        for input in &inputs {
            if let Content::Known(_) = input.content {
                input.floats()?;
            }
        }
        let output = self.made;
        self.made += 1;
        self.drafts.push(DraftStep {
            kind,
            inputs: inputs.into_iter().map(|i| i.content).collect(),
            output,
            len,
        });
        Ok(Value { sizes, content: Content::Made(output) })
    }

    /// Additions and ReLUs become part of the convolutions before them, if nothing else wants those.
    fn taken_in(&mut self, result: &Content) {
        let mut uses = vec![0usize; self.made];
        let mut maker = vec![usize::MAX; self.made];
        let contents = self.drafts.iter().flat_map(|draft| &draft.inputs).chain([result]);
        for content in contents {
            if let Content::Made(number) = content {
                uses[*number] += 1;
            }
        }
        for at in 0..self.drafts.len() {
            maker[self.drafts[at].output] = at;
            // Who made an operand, if this is its only use.
            let own = |content: &Content| match content {
                Content::Made(number) if uses[*number] == 1 => {
                    self.drafts.get(maker[*number]).map(|_| maker[*number])
                }
                _ => None,
            };
            let is_add = matches!(
                self.drafts[at].kind,
                Kind::Other(Op::Binary { kind: BinaryOp::Add, spread: [Spread::Same, Spread::Same] })
            );
            let is_relu = matches!(self.drafts[at].kind, Kind::Other(Op::Unary(UnaryOp::Relu)));
            let plain = |maker: &usize| {
                let before = &self.drafts[*maker];
                matches!(&before.kind, Kind::Conv(conv) if !conv.relu && (is_relu || before.inputs.len() == 1))
            };
            let found = (is_add || is_relu)
                .then(|| {
                    (0..self.drafts[at].inputs.len())
                        .rev()
                        .find_map(|n| own(&self.drafts[at].inputs[n]).filter(plain).map(|maker| (n, maker)))
                })
                .flatten();
            let Some((operand, conv)) = found else { continue };
            let other = is_add.then(|| self.drafts[at].inputs[1 - operand].clone());
            let doubled =
                other.as_ref().and_then(own).filter(|m| matches!(self.drafts[*m].kind, Kind::Doubled(_)));
            let mut inputs = std::mem::take(&mut self.drafts[conv].inputs);
            let Kind::Conv(mut kind) = std::mem::replace(&mut self.drafts[conv].kind, Kind::Gone) else {
                continue;
            };
            kind.relu |= is_relu;
            kind.halved |= doubled.is_some();
            if let Some(doubled) = doubled {
                self.drafts[doubled].kind = Kind::Gone;
                inputs.append(&mut self.drafts[doubled].inputs);
            } else {
                inputs.extend(other);
            }
            self.drafts[at].kind = Kind::Conv(kind);
            self.drafts[at].inputs = inputs;
        }
    }

    /// The plan: who uses which buffer until when.
    fn finished(self, result: Content, shapes: [[usize; 4]; 2], threads: usize) -> Outcome<Plan> {
        let drafts: Vec<DraftStep> =
            self.drafts.into_iter().filter(|d| !matches!(d.kind, Kind::Gone)).collect();
        let mut last = vec![0; self.made];
        for (at, draft) in drafts.iter().enumerate() {
            for input in &draft.inputs {
                if let Content::Made(number) = input {
                    last[*number] = at;
                }
            }
        }
        if let Content::Made(number) = result {
            last[number] = drafts.len();
        }
        let mut buffers: Vec<usize> = Vec::new();
        let mut free: Vec<usize> = Vec::new();
        // Buffer and length of each array.
        let mut homes = vec![None; self.made];
        let source = |content: &Content, homes: &[Option<(usize, usize)>]| match content {
            Content::Made(INPUT) => Ok(Source::Input),
            Content::Made(number) => match homes[*number] {
                Some((buffer, len)) => Ok(Source::Buffer(buffer, len)),
                None => wrong("an array is used before it is made"),
            },
            Content::Known(data) => match &**data {
                Data::Floats(values) => Ok(Source::Constant(values.clone())),
                Data::Whole(_) => wrong("whole numbers where floats belong"),
            },
        };
        let mut steps = Vec::new();
        for (at, draft) in drafts.into_iter().enumerate() {
            let DraftStep { kind, inputs, output, len } = draft;
            let buffer = match best_of(&free, &buffers, len) {
                Some(place) => free.swap_remove(place),
                None => {
                    buffers.push(0);
                    buffers.len() - 1
                }
            };
            buffers[buffer] = buffers[buffer].max(len);
            let op = match kind {
                Kind::Conv(draft) => draft.op()?,
                Kind::Doubled(sizes) => Op::Take(doubled(&sizes)),
                Kind::Other(op) => op,
                Kind::Gone => continue,
            };
            let sources = inputs.iter().map(|input| source(input, &homes)).collect::<Outcome<Vec<_>>>()?;
            steps.push(Step { op, inputs: sources, output: buffer, len });
            homes[output] = Some((buffer, len));
            if last[output] == 0 {
                free.push(buffer); // nobody wants it
            }
            for input in &inputs {
                if let Content::Made(number) = input
                    && last[*number] == at
                    && let Some((buffer, _)) = homes[*number]
                    && !free.contains(&buffer)
                {
                    free.push(buffer);
                }
            }
        }
        let result = source(&result, &homes)?;
        let mut plan = Plan { steps, result, buffers, shapes, threads, idle: Arc::default() };
        plan.largest_buffers_first();
        Ok(plan)
    }
}

/// Which of the free buffers: the smallest that is large enough, else the largest of all.
fn best_of(free: &[usize], buffers: &[usize], wanted: usize) -> Option<usize> {
    let size = |place: &usize| buffers[free[*place]];
    let enough = (0..free.len()).filter(|place| size(place) >= wanted).min_by_key(size);
    enough.or_else(|| (0..free.len()).max_by_key(size))
}

impl ConvDraft {
    fn op(self) -> Outcome<Op> {
        let Data::Floats(weights) = &*self.weights else { return wrong("its weights are no floats") };
        let bias = match self.bias.as_deref() {
            Some(Data::Floats(bias)) => bias.as_slice(),
            _ => &[],
        };
        let conv = Conv::new(self.window, self.input, self.output, weights, bias);
        Ok(Op::Conv { conv: Box::new(conv), halved: self.halved, relu: self.relu })
    }
}

/// An operation on arrays that are known.
fn at_once(op: &Op, inputs: &[Rc<Data>], len: usize) -> Outcome<Data> {
    let floats: Option<Vec<&[f32]>> = inputs
        .iter()
        .map(|data| match &**data {
            Data::Floats(values) => Some(values.as_slice()),
            Data::Whole(_) => None,
        })
        .collect();
    if let Some(floats) = floats {
        let mut out = vec![0.0; len];
        op.run(&floats, &mut out, &mut []);
        return Ok(Data::Floats(out));
    }
    let whole: Option<Vec<&[i64]>> = inputs
        .iter()
        .map(|data| match &**data {
            Data::Whole(values) => Some(values.as_slice()),
            Data::Floats(_) => None,
        })
        .collect();
    let whole = whole.ok_or_else(|| bad("floats and whole numbers are mixed"))?;
    let mut out = vec![0i64; len];
    match op {
        Op::Take(places) => ops::take(whole[0], places, &mut out),
        Op::Join(parts) => ops::join(&whole, parts, &mut out),
        Op::Binary { kind, spread } if whole.len() == 2 => {
            let at = |number: usize, n: usize| whole[number][spread[number].place(n, whole[number].len())];
            for (n, out) in out.iter_mut().enumerate() {
                let (a, b) = (at(0, n), at(1, n));
                let value = match kind {
                    BinaryOp::Add => a.checked_add(b),
                    BinaryOp::Sub => a.checked_sub(b),
                    BinaryOp::Mul => a.checked_mul(b),
                    BinaryOp::Div => a.checked_div(b),
                    BinaryOp::Pow => None,
                };
                *out = value.ok_or_else(|| bad("a whole number that is none"))?;
            }
        }
        _ => return wrong("whole numbers where floats belong"),
    }
    Ok(Data::Whole(out))
}

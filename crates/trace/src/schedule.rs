//! Schedules a step graph: hoists what is constant, what changes once per call, once per step, or is only needed after the
//! last step.
//!
//! A step has inputs of three kinds: *fixed* (parameters), *given* (commands: constant during a call) and *carried* (state,
//! which the step itself updates). What depends on fixed inputs only is computed once, what depends on given ones too once
//! per call, and only the rest in every step. A carried input that the step leaves unchanged counts as given. Of the rest,
//! what no later step reads is moved to an epilogue after the last step, computed from values of that step that are kept
//! for it.

use std::collections::HashMap;

use super::trace::{Graph, Node, NodeId};

/// Kind of a graph input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Input {
    /// Never changes: index of a parameter.
    Fixed(u32),
    /// Constant during a call.
    Given(u32),
    /// Written by every step, read by the next. The number is the index of the carried input.
    Carried(u32),
    /// Set anew before every step, from outside.
    Fresh(u32),
}

/// Where a result of the graph goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// Becomes this carried number.
    Carried(u32),
    /// Is only needed after the last step.
    Final(u32),
}

impl Input {
    /// State slot in a drone's home of a given, carried or fresh input.
    pub fn place(self) -> Option<u32> {
        match self {
            Self::Given(p) | Self::Carried(p) | Self::Fresh(p) => Some(p),
            Self::Fixed(_) => None,
        }
    }
}

impl Output {
    /// State slot in a drone's home.
    pub fn place(self) -> u32 {
        match self {
            Self::Carried(p) | Self::Final(p) => p,
        }
    }
}

/// Where code finds a number. All programs that step a drone share its state slots (home), so switching between them copies
/// nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Location {
    /// In this state slot of the home.
    Home(u32),
    /// In this cell of the program's scratch: `[constant table | given | per-call table | numbers for the epilogue]`.
    /// Given inputs are copied there, so that one program serves commands from outside and those handed on by another stage.
    Scratch(u32),
}

/// One instruction of straight-line code; operands are indices of earlier instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Instruction {
    /// A constant, by the bits of its f64.
    Lit(u64),
    /// An entry of the constant table.
    Constant(u32),
    /// An entry of the per-call table.
    Call(u32),
    /// A state slot.
    State(u32),
    /// a + b.
    Add(u32, u32),
    /// a − b.
    Sub(u32, u32),
    /// a b.
    Mul(u32, u32),
    /// a / b.
    Div(u32, u32),
    /// a / b where the third is 1 / b.
    Over(u32, u32, u32),
    /// a b + c.
    MulAdd(u32, u32, u32),
    /// a b − c.
    MulSub(u32, u32, u32),
    /// c − a b.
    MulFrom(u32, u32, u32),
    /// −a.
    Neg(u32),
    /// √a.
    Sqrt(u32),
    /// |a|.
    Abs(u32),
    /// The smaller of a and b, as [`super::Real::min`].
    Min(u32, u32),
    /// The larger of a and b, as [`super::Real::max`].
    Max(u32, u32),
    /// Sine of a; its cosine is the second result.
    SinCos(u32),
    /// The first of [`super::Real::half_turn`]; the other is the second result.
    HalfTurn(u32),
    /// The second result of an instruction.
    Second(u32),
    /// e to the power of a.
    Exp(u32),
    /// Angle of the point (b, a).
    Atan2(u32, u32),
    /// Largest integer not above a.
    Floor(u32),
    /// Whether a < b.
    Lt(u32, u32),
    /// Whether a ≤ b.
    Le(u32, u32),
    /// Logical and.
    And(u32, u32),
    /// Logical or.
    Or(u32, u32),
    /// Logical not.
    Not(u32),
    /// b where a holds, else c.
    Select(u32, u32, u32),
}

impl Instruction {
    /// Indices of its operands.
    pub fn operands(self) -> [Option<u32>; 3] {
        match self {
            Self::Lit(_) | Self::Constant(_) | Self::Call(_) | Self::State(_) => [None; 3],
            Self::Neg(a) | Self::Sqrt(a) | Self::Abs(a) | Self::SinCos(a) | Self::HalfTurn(a) => {
                [Some(a), None, None]
            }
            Self::Second(a) | Self::Exp(a) | Self::Floor(a) | Self::Not(a) => [Some(a), None, None],
            Self::Add(a, b) | Self::Sub(a, b) | Self::Mul(a, b) | Self::Div(a, b) => [Some(a), Some(b), None],
            Self::Min(a, b) | Self::Max(a, b) | Self::Atan2(a, b) => [Some(a), Some(b), None],
            Self::Lt(a, b) | Self::Le(a, b) | Self::And(a, b) | Self::Or(a, b) => [Some(a), Some(b), None],
            Self::Over(a, b, c) | Self::MulAdd(a, b, c) | Self::MulSub(a, b, c) => {
                [Some(a), Some(b), Some(c)]
            }
            Self::MulFrom(a, b, c) | Self::Select(a, b, c) => [Some(a), Some(b), Some(c)],
        }
    }

    /// Whether its result is a boolean, not a number.
    pub fn is_truth(self) -> bool {
        matches!(self, Self::Lt(..) | Self::Le(..) | Self::And(..) | Self::Or(..) | Self::Not(_))
    }
}

/// Straight-line code: instructions, and which of their values are stored where.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Code {
    /// Instructions, in an order in which operands come first.
    pub instructions: Vec<Instruction>,
    /// (index of the value, slot it is stored to), after all instructions.
    pub stores: Vec<(u32, u32)>,
}

impl Code {
    /// Number of instructions that compute something.
    pub fn operations(&self) -> usize {
        let idle = |i: &Instruction| {
            matches!(
                i,
                Instruction::Lit(_)
                    | Instruction::Constant(_)
                    | Instruction::Call(_)
                    | Instruction::State(_)
                    | Instruction::Second(_)
            )
        };
        self.instructions.iter().filter(|i| !idle(i)).count()
    }
}

/// A step graph scheduled in four stages.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule {
    /// Computed once: from fixed inputs to the entries of the constant table.
    pub once: Graph,
    /// Computed once per call: from given inputs to the entries of the per-call table.
    pub call: Code,
    /// Computed in every step.
    pub step: Code,
    /// Epilogue, computed after the last step, over the same state slots.
    pub epilogue: Code,
    /// Entries of the constant table.
    pub n_constants: usize,
    /// Entries of the per-call table.
    pub n_call: usize,
    /// Input in each slot that the call reads.
    pub given: Vec<Input>,
    /// Contents of each state slot: carried and fresh inputs, and results needed after the last step.
    pub state: Vec<Slot>,
    /// Results that no step computes, and where they come from.
    pub finals: Vec<(Output, Source)>,
}

impl Schedule {
    /// Location of each given input that the call reads.
    pub fn given_at(&self) -> Vec<Location> {
        (self.n_constants..self.n_constants + self.given.len()).map(|k| Location::Scratch(k as u32)).collect()
    }

    /// Location of each entry of the per-call table.
    pub fn call_at(&self) -> Vec<Location> {
        let from = self.n_constants + self.given.len();
        (from..from + self.n_call).map(|k| Location::Scratch(k as u32)).collect()
    }

    /// Location of each state slot.
    pub fn state_at(&self) -> Vec<Location> {
        let mut scratch = (self.n_constants + self.given.len() + self.n_call) as u32;
        let mut at = |slot: &Slot| {
            let place = slot.output.map(Output::place).or(slot.input.and_then(Input::place));
            place.map_or_else(
                || {
                    scratch += 1;
                    Location::Scratch(scratch - 1)
                },
                Location::Home,
            )
        };
        self.state.iter().map(&mut at).collect()
    }

    /// Slots of the state that are given anew before every step.
    pub fn fresh(&self) -> Vec<usize> {
        let is_fresh = |slot: &usize| matches!(self.state[*slot].input, Some(Input::Fresh(_)));
        (0..self.state.len()).filter(is_fresh).collect()
    }

    /// Scratch cells that the program needs.
    pub fn n_scratch(&self) -> usize {
        let kept = self.state.iter().filter(|s| s.input.is_none() && s.output.is_none()).count();
        self.n_constants + self.given.len() + self.n_call + kept
    }

    /// One more than the highest state slot of the home that the program reads or writes.
    pub fn n_home(&self) -> usize {
        let of = |at: Location| if let Location::Home(p) = at { p as usize + 1 } else { 0 };
        self.state_at().into_iter().map(of).max().unwrap_or(0)
    }
}

/// Contents of a state slot. Where it is read from and written to the home, both are the same place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// Input that sets it before the first step; `None` where only results are written to it.
    pub input: Option<Input>,
    /// Result that it holds after the last step; `None` where it is not changed.
    pub output: Option<Output>,
}

/// Where a result that no step computes comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Source {
    /// The per-call table.
    Call(u32),
    /// A state slot, shared with another result.
    State(u32),
    /// This input, unchanged.
    Input(Input),
    /// This constant.
    Constant(f64),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Level {
    Literal,
    Once,
    Call,
    Step,
    Epilogue,
}

/// Schedules a graph, given the kinds of its inputs and the destinations of its results.
pub fn schedule(graph: &Graph, inputs: &[Input], outputs: &[Output]) -> Schedule {
    Scheduler::new(graph, inputs, outputs).run()
}

/// Where the results of a graph are: in slots that a stage stores to, or available elsewhere already.
#[derive(Default)]
struct Results {
    state: Vec<Slot>,
    /// What the step stores, and in which slot.
    stores: Vec<(NodeId, u32)>,
    /// The same of the epilogue.
    last: Vec<(NodeId, u32)>,
    /// Results that no stage stores.
    later: Vec<(Output, NodeId)>,
    slot_of_input: HashMap<Input, u32>,
    slot_of_value: HashMap<NodeId, u32>,
}

struct Scheduler<'a> {
    graph: &'a Graph,
    inputs: &'a [Input],
    outputs: &'a [Output],
    level: Vec<Level>,
    /// Use count of each node: as operand of a needed node, and as result.
    uses: Vec<u32>,
}

impl<'a> Scheduler<'a> {
    fn new(graph: &'a Graph, inputs: &'a [Input], outputs: &'a [Output]) -> Self {
        let kept = |k: u32| {
            graph.outputs.iter().zip(outputs).any(|(place, out)| {
                *out == Output::Carried(k)
                    && matches!(graph.nodes[*place as usize], Node::Input(i) if inputs[i as usize] == Input::Carried(k))
            })
        };
        let mut level: Vec<Level> = Vec::with_capacity(graph.nodes.len());
        for node in &graph.nodes {
            let own = match *node {
                Node::Input(i) => match inputs[i as usize] {
                    Input::Fixed(_) => Level::Once,
                    Input::Given(_) => Level::Call,
                    Input::Carried(k) if kept(k) => Level::Call,
                    Input::Carried(_) | Input::Fresh(_) => Level::Step,
                },
                _ => Level::Literal,
            };
            let most = node.operands().map(|o| level[o as usize]).max().unwrap_or(Level::Literal);
            level.push(own.max(most));
        }
        let epilogue = unread(graph, inputs, outputs, &level);
        for place in epilogue {
            level[place as usize] = Level::Epilogue;
        }
        let mut uses = vec![0; graph.nodes.len()];
        for node in &graph.nodes {
            node.operands().for_each(|o| uses[o as usize] += 1);
        }
        graph.outputs.iter().for_each(|o| uses[*o as usize] += 1);
        Self { graph, inputs, outputs, level, uses }
    }

    fn node(&self, place: NodeId) -> Node {
        self.graph.nodes[place as usize]
    }

    /// Gives state slots to the results that the step computes or must pass on, and to what the epilogue reads of a step.
    fn results(&self) -> Results {
        let graph = self.graph;
        let read = carried(graph, self.inputs, &self.level);
        let mut out = Results::default();
        for (place, output) in graph.outputs.iter().zip(self.outputs) {
            // A carried number that the step passes through needs no store.
            let unchanged = matches!((*output, self.node(*place)), (Output::Carried(k), Node::Input(i))
                if self.inputs[i as usize] == Input::Carried(k));
            if unchanged {
                continue;
            }
            let own = match *output {
                Output::Carried(k) if read.contains(&k) => Some(Input::Carried(k)),
                _ => None,
            };
            let level = self.level[*place as usize];
            // Hoisted, or already in a slot for another result: it is copied when the results are read.
            if own.is_none() && (level < Level::Step || out.slot_of_value.contains_key(place)) {
                out.later.push((*output, *place));
                continue;
            }
            let slot = out.state.len() as u32;
            out.state.push(Slot { input: own, output: Some(*output) });
            if let Some(input) = own {
                out.slot_of_input.insert(input, slot);
            }
            out.slot_of_value.entry(*place).or_insert(slot);
            if level == Level::Epilogue { &mut out.last } else { &mut out.stores }.push((*place, slot));
        }
        // Values of the last step that the epilogue reads get slots beside the results.
        for place in self.kept() {
            out.slot_of_value.entry(place).or_insert_with(|| {
                out.state.push(Slot { input: None, output: None });
                out.stores.push((place, out.state.len() as u32 - 1));
                out.state.len() as u32 - 1
            });
        }
        out
    }

    fn run(self) -> Schedule {
        let Results { state, stores, last, later, slot_of_input, slot_of_value } = self.results();
        // Booleans cannot be stored in a table: a later stage that needs one repeats the comparison.
        let mut step = Builder::new(&self, Level::Step);
        step.slot_of_input = slot_of_input;
        step.slots = state;
        for (place, slot) in &stores {
            let at = step.value(*place);
            step.code.stores.push((at, *slot));
        }
        let mut epilogue = Builder::new(&self, Level::Epilogue);
        // The epilogue shares the table entries of the step.
        epilogue.below_once = std::mem::take(&mut step.below_once);
        epilogue.below_call = std::mem::take(&mut step.below_call);
        epilogue.slot_of_value = slot_of_value.clone();
        for (place, slot) in &last {
            let at = epilogue.value(*place);
            epilogue.code.stores.push((at, *slot));
        }
        let mut wanted_of_call = std::mem::take(&mut epilogue.below_call);
        let finals = self.finals(&later, &slot_of_value, &mut wanted_of_call);
        let table = std::mem::take(&mut epilogue.below_once);
        let (step_code, epilogue_code, state) = (step.code, epilogue.code, step.slots);

        let call = self.call(table, &wanted_of_call);
        // Only given inputs that the call reads get scratch cells.
        let given: Vec<Input> = call.slots.iter().filter_map(|s| s.input).collect();
        let table = call.below_once;
        let once = self.once(&table);
        Schedule {
            once,
            n_constants: table.len(),
            n_call: wanted_of_call.len(),
            call: call.code,
            step: step_code,
            epilogue: epilogue_code,
            given,
            state,
            finals,
        }
    }

    /// Where results come from that no step computes; what the call has to add for them is appended to `wanted_of_call`.
    fn finals(
        &self,
        later: &[(Output, NodeId)],
        slot_of_value: &HashMap<NodeId, u32>,
        wanted_of_call: &mut Vec<Want>,
    ) -> Vec<(Output, Source)> {
        let mut finals = Vec::new();
        for &(output, place) in later {
            let source = match self.node(place) {
                Node::Literal(bits) => Source::Constant(f64::from_bits(bits)),
                _ if self.level[place as usize] >= Level::Step => Source::State(slot_of_value[&place]),
                Node::Input(i) => Source::Input(self.inputs[i as usize]),
                _ => {
                    let next = wanted_of_call.len() as u32;
                    let at = wanted_of_call.iter().position(|p| *p == Want::Value(place));
                    let at = at.map_or(next, |i| i as u32);
                    if at == next {
                        wanted_of_call.push(Want::Value(place));
                    }
                    Source::Call(at)
                }
            };
            finals.push((output, source));
        }
        finals
    }

    /// The code of the call, which fills the per-call table with what is wanted of it; `table` is what is wanted of the constant table so
    /// far.
    fn call<'b>(&'b self, table: Vec<Want>, wanted: &[Want]) -> Builder<'a, 'b> {
        let mut call = Builder::new(self, Level::Call);
        call.below_once = table;
        for (slot, want) in wanted.iter().enumerate() {
            let at = match *want {
                Want::Value(place) => call.value(place),
                Want::Reciprocal(place) => {
                    let one = call.push(Instruction::Lit(1f64.to_bits()));
                    let of = call.value(place);
                    call.push(Instruction::Div(one, of))
                }
            };
            call.code.stores.push((at, slot as u32));
        }
        call
    }

    /// Values of a step that the epilogue reads.
    fn kept(&self) -> Vec<NodeId> {
        let mut out = Vec::new();
        let mut todo: Vec<NodeId> =
            (0..self.level.len() as NodeId).filter(|p| self.level[*p as usize] == Level::Epilogue).collect();
        let mut next = 0;
        while let Some(place) = todo.get(next).copied() {
            next += 1;
            for operand in self.node(place).operands() {
                if self.level[operand as usize] != Level::Step || todo.contains(&operand) {
                    continue;
                }
                // Comparisons are repeated, not stored.
                if self.node(operand).is_truth() {
                    todo.push(operand);
                } else if !out.contains(&operand) {
                    out.push(operand);
                }
            }
        }
        out.sort_unstable();
        out
    }

    /// The graph that fills the constant table from fixed inputs.
    fn once(&self, table: &[Want]) -> Graph {
        let mut nodes: Vec<Node> = Vec::new();
        let mut moved: HashMap<NodeId, NodeId> = HashMap::new();
        for (place, node) in self.graph.nodes.iter().enumerate() {
            if self.level[place] > Level::Once {
                continue;
            }
            let node = match *node {
                Node::Input(i) => match self.inputs[i as usize] {
                    Input::Fixed(k) => Node::Input(k),
                    _ => continue,
                },
                other => other.with(|o| moved[&o]),
            };
            moved.insert(place as NodeId, nodes.len() as NodeId);
            nodes.push(node);
        }
        let mut outputs = Vec::new();
        for want in table {
            outputs.push(match *want {
                Want::Value(place) => moved[&place],
                Want::Reciprocal(place) => {
                    nodes.push(Node::Literal(1f64.to_bits()));
                    nodes.push(Node::Div(nodes.len() as NodeId - 1, moved[&place]));
                    nodes.len() as NodeId - 1
                }
            });
        }
        let n_inputs =
            self.inputs.iter().map(|i| if let Input::Fixed(k) = i { *k as usize + 1 } else { 0 }).max();
        Graph { n_inputs: n_inputs.unwrap_or(0), nodes, outputs }.needed()
    }
}

/// Carried inputs that per-step nodes read.
fn carried(graph: &Graph, inputs: &[Input], level: &[Level]) -> Vec<u32> {
    let nodes = graph.nodes.iter().zip(level).filter(|(_, level)| **level == Level::Step);
    let read = nodes.filter_map(|(node, _)| match node {
        Node::Input(i) => match inputs[*i as usize] {
            Input::Carried(k) => Some(k),
            _ => None,
        },
        _ => None,
    });
    read.collect()
}

/// Per-step nodes that are only needed for results which no later step reads.
fn unread(graph: &Graph, inputs: &[Input], outputs: &[Output], level: &[Level]) -> Vec<NodeId> {
    let read = carried(graph, inputs, level);
    let (mut needed, mut wanted) = (vec![false; graph.nodes.len()], vec![false; graph.nodes.len()]);
    for (place, output) in graph.outputs.iter().zip(outputs) {
        let kept = matches!(output, Output::Carried(k) if read.contains(k));
        (if kept { &mut needed } else { &mut wanted })[*place as usize] = true;
    }
    for (place, node) in graph.nodes.iter().enumerate().rev() {
        for operand in node.operands() {
            needed[operand as usize] |= needed[place];
            wanted[operand as usize] |= wanted[place];
        }
    }
    let is_unread = |p: &usize| {
        let input = matches!(graph.nodes[*p], Node::Input(_));
        level[*p] == Level::Step && wanted[*p] && !needed[*p] && !input
    };
    (0..graph.nodes.len()).filter(is_unread).map(|p| p as NodeId).collect()
}

/// An entry of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Want {
    Value(NodeId),
    Reciprocal(NodeId),
}

/// Emits the code of one stage.
struct Builder<'a, 'b> {
    of: &'b Scheduler<'a>,
    level: Level,
    code: Code,
    /// Instruction that holds a node's value.
    held: HashMap<NodeId, u32>,
    shared: HashMap<Instruction, u32>,
    below_once: Vec<Want>,
    below_call: Vec<Want>,
    slot_of_input: HashMap<Input, u32>,
    /// Slots that hold values of a step for the epilogue.
    slot_of_value: HashMap<NodeId, u32>,
    slots: Vec<Slot>,
}

impl<'a, 'b> Builder<'a, 'b> {
    fn new(of: &'b Scheduler<'a>, level: Level) -> Self {
        Self {
            of,
            level,
            code: Code::default(),
            held: HashMap::new(),
            shared: HashMap::new(),
            below_once: Vec::new(),
            below_call: Vec::new(),
            slot_of_input: HashMap::new(),
            slot_of_value: HashMap::new(),
            slots: Vec::new(),
        }
    }

    fn push(&mut self, ins: Instruction) -> u32 {
        if let Some(at) = self.shared.get(&ins) {
            return *at;
        }
        let at = self.code.instructions.len() as u32;
        self.code.instructions.push(ins);
        self.shared.insert(ins, at);
        at
    }

    fn entry(list: &mut Vec<Want>, want: Want) -> u32 {
        let at = list.iter().position(|w| *w == want).unwrap_or(list.len());
        if at == list.len() {
            list.push(want);
        }
        at as u32
    }

    /// The instruction that holds a node's value: computed here, or loaded from where an earlier stage stored it.
    fn value(&mut self, place: NodeId) -> u32 {
        // Depth first without recursion, since graphs may be deep.
        let mut todo = vec![place];
        while let Some(next) = todo.last().copied() {
            if self.held.contains_key(&next) {
                todo.pop();
                continue;
            }
            let missing: Vec<NodeId> =
                self.needs(next).into_iter().filter(|p| !self.held.contains_key(p)).collect();
            if missing.is_empty() {
                todo.pop();
                let at = self.compute(next);
                self.held.insert(next, at);
            } else {
                todo.extend(missing.into_iter().rev());
            }
        }
        self.held[&place]
    }

    /// Whether a value is loaded, not computed here.
    fn is_read(&self, place: NodeId) -> bool {
        let node = self.of.node(place);
        let level = self.of.level[place as usize];
        matches!(node, Node::Input(_)) || (level < self.level && level > Level::Literal && !node.is_truth())
    }

    /// Operands that `compute` needs.
    fn needs(&self, place: NodeId) -> Vec<NodeId> {
        if self.is_read(place) {
            return vec![];
        }
        match self.of.node(place) {
            Node::Add(a, b) | Node::Sub(a, b) => match self.product(place) {
                Some((true, x, y)) => vec![x, y, b],
                Some((false, x, y)) => vec![a, x, y],
                None => vec![a, b],
            },
            node => match self.bound(node) {
                Some((a, b, _)) => vec![a, b],
                None => node.operands().collect(),
            },
        }
    }

    /// A product to fuse into a sum or difference: whether it is the first operand, and its factors.
    fn product(&self, place: NodeId) -> Option<(bool, NodeId, NodeId)> {
        let of = |p: NodeId| match self.of.node(p) {
            Node::Mul(x, y)
                if self.of.uses[p as usize] == 1
                    && self.of.level[p as usize] == self.level
                    && !self.held.contains_key(&p) =>
            {
                Some((x, y))
            }
            _ => None,
        };
        match self.of.node(place) {
            Node::Add(a, b) | Node::Sub(a, b) => {
                of(a).map(|(x, y)| (true, x, y)).or_else(|| of(b).map(|(x, y)| (false, x, y)))
            }
            _ => None,
        }
    }

    /// A select that is a magnitude, a minimum or a maximum.
    fn bound(&self, node: Node) -> Option<(NodeId, NodeId, Instruction)> {
        let Node::Select(m, yes, no) = node else { return None };
        let Node::Lt(a, b) = self.of.node(m) else { return None };
        if (yes, no) == (b, a) {
            return Some((a, b, Instruction::Max(0, 0)));
        }
        if (yes, no) == (a, b) {
            return Some((b, a, Instruction::Min(0, 0)));
        }
        let zero = matches!(self.of.node(b), Node::Literal(bits) if f64::from_bits(bits) == 0.0);
        let negated = matches!(self.of.node(yes), Node::Neg(x) if x == a);
        (zero && negated && no == a).then_some((a, a, Instruction::Abs(0)))
    }

    fn compute(&mut self, place: NodeId) -> u32 {
        let node = self.of.node(place);
        if self.is_read(place) {
            return self.read(place, node);
        }
        let h = |p: NodeId| self.held[&p];
        let ins = match node {
            Node::Literal(bits) => Instruction::Lit(bits),
            Node::Input(_) => unreachable!("inputs are read"),
            Node::Add(a, b) => match self.product(place) {
                Some((true, x, y)) => Instruction::MulAdd(h(x), h(y), h(b)),
                Some((false, x, y)) => Instruction::MulAdd(h(x), h(y), h(a)),
                None => Instruction::Add(h(a), h(b)),
            },
            Node::Sub(a, b) => match self.product(place) {
                Some((true, x, y)) => Instruction::MulSub(h(x), h(y), h(b)),
                Some((false, x, y)) => Instruction::MulFrom(h(x), h(y), h(a)),
                None => Instruction::Sub(h(a), h(b)),
            },
            Node::Mul(a, b) => Instruction::Mul(h(a), h(b)),
            // The reciprocal of a hoisted divisor is hoisted too: lanes multiply by it, scalar f64 code divides.
            Node::Div(a, b) => {
                let (a_at, b_at) = (h(a), h(b));
                match self.of.level[b as usize] {
                    Level::Once => {
                        let at = Self::entry(&mut self.below_once, Want::Reciprocal(b));
                        let reciprocal = self.push(Instruction::Constant(at));
                        Instruction::Over(a_at, b_at, reciprocal)
                    }
                    Level::Call if self.level > Level::Call => {
                        let at = Self::entry(&mut self.below_call, Want::Reciprocal(b));
                        let reciprocal = self.push(Instruction::Call(at));
                        Instruction::Over(a_at, b_at, reciprocal)
                    }
                    _ => Instruction::Div(a_at, b_at),
                }
            }
            Node::Neg(a) => Instruction::Neg(h(a)),
            Node::Sqrt(a) => Instruction::Sqrt(h(a)),
            Node::Sin(a) => Instruction::SinCos(h(a)),
            // Sine and cosine of an angle share one instruction (`push` merges equal ones).
            Node::Cos(a) => {
                let both = Instruction::SinCos(h(a));
                let at = self.push(both);
                Instruction::Second(at)
            }
            Node::TurnSin(a) => Instruction::HalfTurn(h(a)),
            Node::TurnCos(a) => {
                let both = Instruction::HalfTurn(h(a));
                let at = self.push(both);
                Instruction::Second(at)
            }
            Node::Exp(a) => Instruction::Exp(h(a)),
            Node::Atan2(a, b) => Instruction::Atan2(h(a), h(b)),
            Node::Floor(a) => Instruction::Floor(h(a)),
            Node::Lt(a, b) => Instruction::Lt(h(a), h(b)),
            Node::Le(a, b) => Instruction::Le(h(a), h(b)),
            // There is no boolean literal: 0 ≤ 0 or 0 < 0.
            Node::Truth(truth) => {
                let zero = self.push(Instruction::Lit(0));
                if truth { Instruction::Le(zero, zero) } else { Instruction::Lt(zero, zero) }
            }
            Node::And(a, b) => Instruction::And(h(a), h(b)),
            Node::Or(a, b) => Instruction::Or(h(a), h(b)),
            Node::Not(a) => Instruction::Not(h(a)),
            // Selects that are minima, maxima or magnitudes have instructions of their own.
            Node::Select(a, b, c) => match self.bound(node) {
                Some((x, y, Instruction::Max(..))) => Instruction::Max(h(x), h(y)),
                Some((x, y, Instruction::Min(..))) => Instruction::Min(h(x), h(y)),
                Some((x, _, _)) => Instruction::Abs(h(x)),
                None => Instruction::Select(h(a), h(b), h(c)),
            },
        };
        self.push(ins)
    }

    fn read(&mut self, place: NodeId, node: Node) -> u32 {
        match (self.of.level[place as usize], node) {
            (Level::Once, _) => {
                let at = Self::entry(&mut self.below_once, Want::Value(place));
                self.push(Instruction::Constant(at))
            }
            (Level::Call, _) if self.level > Level::Call => {
                let at = Self::entry(&mut self.below_call, Want::Value(place));
                self.push(Instruction::Call(at))
            }
            (Level::Step, _) if self.level == Level::Epilogue => {
                self.push(Instruction::State(self.slot_of_value[&place]))
            }
            (_, Node::Input(i)) => {
                let input = self.of.inputs[i as usize];
                let next = self.slots.len() as u32;
                let at = *self.slot_of_input.entry(input).or_insert(next);
                if at == next {
                    self.slots.push(Slot { input: Some(input), output: None });
                }
                self.push(Instruction::State(at))
            }
            _ => unreachable!("only what a lower level computed is read"),
        }
    }
}

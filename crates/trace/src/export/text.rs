//! A traced function as source of another language: C, CUDA, WGSL, NumPy, JAX, CasADi, LaTeX.
//!
//! Every language gets the same straight-line code, an operation to a line; only the spelling differs.

use std::fmt::Write as _;

use crate::adjoint::evaluate_with;
use crate::half_turn_by_root;
use crate::lanes::Number as _;
use crate::trace::{Graph, Node, Sym, trace_finite};

/// A vector that goes into a function or comes out.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Its name, one that all languages take.
    pub name: String,
    /// What it is, in a line.
    pub about: String,
    /// Names of its numbers, with units.
    pub entries: Vec<String>,
    /// Usual values.
    pub defaults: Vec<f64>,
}

/// A function that can be printed.
#[derive(Clone, Debug, PartialEq)]
pub struct Printed {
    /// Its name.
    pub name: String,
    /// What it computes, in a line.
    pub about: String,
    /// What goes in, in the order of the inputs of the graph.
    pub inputs: Vec<Group>,
    /// What comes out, in the order of its results.
    pub outputs: Vec<Group>,
    /// The formula.
    pub graph: Graph,
}

/// A language.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Language {
    /// C99 in double, with nothing but `math.h`.
    C,
    /// The same in float.
    CFloat,
    /// A device function of CUDA in float.
    Cuda,
    /// WebGPU's shading language, in f32.
    Wgsl,
    /// A Python function over NumPy arrays, or those of any library with its functions; leading axes are a batch.
    NumPy,
    /// The same over JAX arrays: it can be jitted, mapped and differentiated.
    Jax,
    /// A Python function that makes a `casadi.Function`.
    CasAdi,
    /// Equations to read.
    Latex,
}

impl Language {
    /// All, with their names.
    pub const ALL: [(&'static str, Self); 8] = [
        ("c", Self::C),
        ("c-float", Self::CFloat),
        ("cuda", Self::Cuda),
        ("wgsl", Self::Wgsl),
        ("numpy", Self::NumPy),
        ("jax", Self::Jax),
        ("casadi", Self::CasAdi),
        ("latex", Self::Latex),
    ];

    /// That of a name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(own, _)| *own == name).map(|(_, language)| *language)
    }

    fn is_c(self) -> bool {
        matches!(self, Self::C | Self::CFloat | Self::Cuda)
    }

    fn is_python(self) -> bool {
        matches!(self, Self::NumPy | Self::Jax)
    }

    /// A constant.
    fn literal(self, v: f64) -> String {
        // As lanes do it: what f32 has no place for is the smallest that it has.
        let single = || f32::constant(v).wide();
        match self {
            Self::CFloat | Self::Cuda => format!("{:?}f", single()),
            Self::Wgsl => format!("{:?}", single()),
            Self::Latex => {
                let text = format!("{v:?}");
                text.split_once('e').map_or(text.clone(), |(a, b)| format!("{a} \\cdot 10^{{{b}}}"))
            }
            _ => format!("{v:?}"),
        }
    }

    /// A number of an input.
    fn entry(self, group: &str, k: usize) -> String {
        match self {
            Self::NumPy | Self::Jax => format!("{group}[..., {k}]"),
            Self::Latex => format!("{}_{{{}}}", group.replace('_', "\\_"), k + 1),
            _ => format!("{group}[{k}]"),
        }
    }

    /// A function of C with the ending of its number type.
    fn call(self, name: &str, operands: &[&str]) -> String {
        let (before, after) = match self {
            Self::CFloat | Self::Cuda => ("", "f"),
            Self::NumPy | Self::Jax => ("xp.", ""),
            Self::CasAdi => ("ca.", ""),
            _ => ("", ""),
        };
        format!("{before}{name}{after}({})", operands.join(", "))
    }

    /// The expression of a node over those of its operands.
    fn expression(self, node: Node, o: &[&str]) -> String {
        if self == Self::Latex {
            return latex(node, o);
        }
        let two = |sign: &str| format!("{} {sign} {}", o[0], o[1]);
        let logic = |c: &str, python: &str, casadi: &str| match self {
            Self::NumPy | Self::Jax => two(python),
            Self::CasAdi => self.call(casadi, o),
            _ => two(c),
        };
        match node {
            Node::Add(..) => two("+"),
            Node::Sub(..) => two("-"),
            Node::Mul(..) => two("*"),
            Node::Div(..) => two("/"),
            Node::Neg(_) => format!("-{}", o[0]),
            Node::Sqrt(_) => self.call("sqrt", o),
            Node::Sin(_) => self.call("sin", o),
            Node::Cos(_) => self.call("cos", o),
            Node::Exp(_) => self.call("exp", o),
            Node::Floor(_) => self.call("floor", o),
            // The array API and NumPy 1 have no name for it in common.
            Node::Atan2(..) if self.is_python() => self.call("arctan2", o),
            Node::Atan2(..) => self.call("atan2", o),
            Node::Lt(..) => two("<"),
            Node::Le(..) => two("<="),
            Node::And(..) => logic("&", "&", "logic_and"),
            Node::Or(..) => logic("|", "|", "logic_or"),
            Node::Not(_) => match self {
                Self::NumPy | Self::Jax => format!("~{}", o[0]),
                Self::CasAdi => self.call("logic_not", o),
                _ => format!("!{}", o[0]),
            },
            Node::Truth(truth) => match self {
                Self::NumPy | Self::Jax => format!("xp.asarray({})", if truth { "True" } else { "False" }),
                Self::CasAdi => format!("ca.SX({})", u8::from(truth)),
                Self::Wgsl => truth.to_string(),
                _ => u8::from(truth).to_string(),
            },
            Node::Select(..) => match self {
                Self::NumPy | Self::Jax => self.call("where", o),
                Self::CasAdi => self.call("if_else", o),
                Self::Wgsl => format!("select({}, {}, {})", o[2], o[1], o[0]),
                _ => format!("{} ? {} : {}", o[0], o[1], o[2]),
            },
            Node::Literal(_) | Node::Input(_) | Node::TurnSin(_) | Node::TurnCos(_) => String::new(),
        }
    }
}

/// A node as an equation's right side.
fn latex(node: Node, o: &[&str]) -> String {
    let function = |name: &str| format!("\\{name}\\left({}\\right)", o.join(", "));
    match node {
        Node::Add(..) => format!("{} + {}", o[0], o[1]),
        Node::Sub(..) => format!("{} - {}", o[0], o[1]),
        Node::Mul(..) => format!("{} \\, {}", o[0], o[1]),
        Node::Div(..) => format!("\\frac{{{}}}{{{}}}", o[0], o[1]),
        Node::Neg(_) => format!("-{}", o[0]),
        Node::Sqrt(_) => format!("\\sqrt{{{}}}", o[0]),
        Node::Sin(_) => function("sin"),
        Node::Cos(_) => function("cos"),
        Node::Exp(_) => format!("e^{{{}}}", o[0]),
        Node::Atan2(..) => function("operatorname{atan2}"),
        Node::Floor(_) => format!("\\lfloor {} \\rfloor", o[0]),
        Node::Lt(..) => format!("{} < {}", o[0], o[1]),
        Node::Le(..) => format!("{} \\le {}", o[0], o[1]),
        Node::And(..) => format!("{} \\land {}", o[0], o[1]),
        Node::Or(..) => format!("{} \\lor {}", o[0], o[1]),
        Node::Not(_) => format!("\\lnot {}", o[0]),
        Node::Truth(truth) => format!("\\mathrm{{{truth}}}"),
        Node::Select(..) => {
            format!(
                "\\begin{{cases}} {} & \\text{{if }} {} \\\\ {} & \\text{{else}} \\end{{cases}}",
                o[1], o[0], o[2]
            )
        }
        Node::Literal(_) | Node::Input(_) | Node::TurnSin(_) | Node::TurnCos(_) => String::new(),
    }
}

/// The graph with the functions of half an angle written out, which no other language has.
pub fn written_out(graph: &Graph) -> Graph {
    trace_finite(graph.n_inputs, |x| evaluate_with::<Sym>(graph, x, half_turn_by_root))
}

impl Printed {
    /// Usual values of all inputs.
    pub fn defaults(&self) -> Vec<Vec<f64>> {
        self.inputs.iter().map(|g| g.defaults.clone()).collect()
    }

    /// Names of the inputs.
    pub fn input_names(&self) -> Vec<&str> {
        self.inputs.iter().map(|g| g.name.as_str()).collect()
    }

    /// The results in f64, one list for each output; none where an input has another length than its group.
    pub fn evaluate(&self, inputs: &[Vec<f64>]) -> Option<Vec<Vec<f64>>> {
        let fits = inputs.len() == self.inputs.len()
            && inputs.iter().zip(&self.inputs).all(|(own, group)| own.len() == group.entries.len());
        let mut results = fits.then(|| self.graph.eval(&inputs.concat()))?.into_iter();
        Some(self.outputs.iter().map(|g| results.by_ref().take(g.entries.len()).collect()).collect())
    }

    /// Its source.
    pub fn print(&self, language: Language) -> String {
        let (lines, results) = self.lines(language);
        match language {
            Language::C | Language::CFloat | Language::Cuda => self.c(language, &lines, &results),
            Language::Wgsl => self.wgsl(&lines, &results),
            Language::NumPy | Language::Jax => self.python(language, &lines, &results),
            Language::CasAdi => self.casadi(&lines, &results),
            Language::Latex => self.latex(&lines, &results),
        }
    }

    /// Statements without what declares their variables, (is it a truth, text), and the expressions of the results.
    fn lines(&self, language: Language) -> (Vec<(bool, String)>, Vec<String>) {
        let mut names: Vec<String> = Vec::with_capacity(self.graph.nodes.len());
        let inputs: Vec<String> = self
            .inputs
            .iter()
            .flat_map(|g| (0..g.entries.len()).map(|k| language.entry(&g.name, k)))
            .collect();
        let mut lines = Vec::new();
        for node in &self.graph.nodes {
            names.push(match *node {
                Node::Input(k) => inputs[k as usize].clone(),
                Node::Literal(bits) => {
                    let v = f64::from_bits(bits);
                    let text = language.literal(v);
                    if v.is_sign_negative() { format!("({text})") } else { text }
                }
                node => {
                    let operands: Vec<&str> = node.operands().map(|o| names[o as usize].as_str()).collect();
                    let name = if language == Language::Latex {
                        format!("v_{{{}}}", lines.len() + 1)
                    } else {
                        format!("v{}", lines.len())
                    };
                    let equals = if language == Language::Latex { "&=" } else { "=" };
                    lines.push((
                        node.is_truth(),
                        format!("{name} {equals} {}", language.expression(node, &operands)),
                    ));
                    name
                }
            });
        }
        let results = self.graph.outputs.iter().map(|o| names[*o as usize].clone()).collect();
        (lines, results)
    }

    /// What goes in and comes out, a line for each vector.
    fn described(&self) -> Vec<String> {
        let line = |g: &Group, of: &str| {
            format!("{of} {}[{}]: {}: {}", g.name, g.entries.len(), g.about, g.entries.join(", "))
        };
        self.inputs.iter().map(|g| line(g, "in")).chain(self.outputs.iter().map(|g| line(g, "out"))).collect()
    }

    /// The results of each output, with its group.
    fn parted<'a>(&'a self, results: &'a [String]) -> Vec<(&'a Group, &'a [String])> {
        let mut from = 0;
        let part = |g: &'a Group| {
            from += g.entries.len();
            (g, &results[from - g.entries.len()..from])
        };
        self.outputs.iter().map(part).collect()
    }

    fn c(&self, language: Language, lines: &[(bool, String)], results: &[String]) -> String {
        debug_assert!(language.is_c());
        let number = if language == Language::C { "double" } else { "float" };
        let mut out = format!("/* {}. Printed by Propwash. */\n", self.about);
        for line in self.described() {
            let _ = writeln!(out, "/* {line} */");
        }
        out.push_str(if language == Language::Cuda { "" } else { "#include <math.h>\n" });
        let inputs = self.inputs.iter().map(|g| format!("const {number} *{}", g.name));
        let outputs = self.outputs.iter().map(|g| format!("{number} *{}", g.name));
        let parameters: Vec<String> = inputs.chain(outputs).collect();
        let (before, own) =
            if language == Language::Cuda { ("__device__ ", "") } else { ("", &self.name[..]) };
        let _ = match own {
            "" => writeln!(out, "{before}void {}({}) {{", self.name, parameters.join(", ")),
            // Declared first: some warn of functions that nobody declared.
            _ => writeln!(out, "void {own}({p});\nvoid {own}({p}) {{", p = parameters.join(", ")),
        };
        for group in &self.inputs {
            let _ = writeln!(out, "  (void){};", group.name);
        }
        for (truth, line) in lines {
            let _ = writeln!(out, "  const {} {line};", if *truth { "int" } else { number });
        }
        for (group, results) in self.parted(results) {
            for (k, result) in results.iter().enumerate() {
                let _ = writeln!(out, "  {}[{k}] = {result};", group.name);
            }
        }
        out.push_str("}\n");
        out
    }

    fn wgsl(&self, lines: &[(bool, String)], results: &[String]) -> String {
        let array = |g: &Group| format!("{}: array<f32, {}>", g.name, g.entries.len());
        let mut out = format!("// {}. Printed by Propwash.\n", self.about);
        for line in self.described() {
            let _ = writeln!(out, "// {line}");
        }
        let fields: Vec<String> = self.outputs.iter().map(array).collect();
        let parameters: Vec<String> = self.inputs.iter().map(array).collect();
        let name = &self.name;
        let _ = writeln!(out, "struct {name}_out {{ {} }}", fields.join(", "));
        let _ = writeln!(out, "fn {name}({}) -> {name}_out {{", parameters.join(", "));
        for (_, line) in lines {
            let _ = writeln!(out, "  let {line};");
        }
        let made: Vec<String> = self
            .parted(results)
            .iter()
            .map(|(g, results)| format!("array<f32, {}>({})", g.entries.len(), results.join(", ")))
            .collect();
        let _ = writeln!(out, "  return {name}_out({});\n}}", made.join(", "));
        out
    }

    /// The head of a Python function's documentation.
    fn docstring(&self, before: &str) -> String {
        let lines: String = self.described().iter().map(|line| format!("    {line}\n")).collect();
        format!("    \"\"\"{}. Printed by Propwash.\n\n{before}{lines}    \"\"\"\n", self.about)
    }

    fn python(&self, language: Language, lines: &[(bool, String)], results: &[String]) -> String {
        debug_assert!(language.is_python());
        let library = if language == Language::Jax { "jax.numpy" } else { "numpy" };
        let names = self.input_names().join(", ");
        let mut out = format!("import {library} as _own\n\n\ndef {}({names}, xp=_own):\n", self.name);
        out.push_str(&self.docstring("    Last axes are the vectors below, leading axes a batch; `xp` is the library of the arrays.\n\n"));
        for group in &self.inputs {
            let _ = writeln!(out, "    {0} = xp.asarray({0})", group.name);
        }
        let shapes: Vec<String> = self.inputs.iter().map(|g| format!("{}.shape[:-1]", g.name)).collect();
        let _ = writeln!(out, "    batch = xp.broadcast_shapes({})", shapes.join(", "));
        for (_, line) in lines {
            let _ = writeln!(out, "    {line}");
        }
        let made: Vec<String> = self
            .parted(results)
            .iter()
            .map(|(_, results)| {
                // What no input reaches has no batch of its own.
                format!("xp.stack([xp.broadcast_to(v, batch) for v in ({},)], axis=-1)", results.join(", "))
            })
            .collect();
        let _ = writeln!(out, "    return {}", made.join(", "));
        out
    }

    fn casadi(&self, lines: &[(bool, String)], results: &[String]) -> String {
        let mut out = format!("import casadi as ca\n\n\ndef {}():\n", self.name);
        out.push_str(&self.docstring("    Returns the casadi.Function of the vectors below.\n\n"));
        for group in &self.inputs {
            let _ = writeln!(out, "    {0} = ca.SX.sym(\"{0}\", {1})", group.name, group.entries.len());
        }
        for (_, line) in lines {
            let _ = writeln!(out, "    {line}");
        }
        let made: Vec<String> = self
            .parted(results)
            .iter()
            .map(|(_, results)| format!("ca.vertcat({})", results.join(", ")))
            .collect();
        let quoted = |groups: &[Group]| {
            groups.iter().map(|g| format!("\"{}\"", g.name)).collect::<Vec<_>>().join(", ")
        };
        let _ = writeln!(
            out,
            "    return ca.Function(\"{}\", [{}], [{}], [{}], [{}])",
            self.name,
            self.input_names().join(", "),
            made.join(", "),
            quoted(&self.inputs),
            quoted(&self.outputs)
        );
        out
    }

    fn latex(&self, lines: &[(bool, String)], results: &[String]) -> String {
        let plain = |text: &str| text.replace('_', "\\_").replace('²', "\\textsuperscript{2}");
        let mut out = format!("% {}. Printed by Propwash; needs amsmath.\n", self.about);
        for line in self.described() {
            let _ = writeln!(out, "{}\\par", plain(&line));
        }
        out.push_str("{\\allowdisplaybreaks\\begin{align*}\n");
        for (_, line) in lines {
            let _ = writeln!(out, "{line} \\\\");
        }
        for (group, results) in self.parted(results) {
            for (k, result) in results.iter().enumerate() {
                let _ = writeln!(out, "{}_{{{}}} &= {result} \\\\", plain(&group.name), k + 1);
            }
        }
        out.push_str("\\end{align*}}\n");
        out
    }
}

//! A tree of boxes over triangles or geoms.

/// Most triangles of a leaf.
const LEAF: usize = 4;
/// Bins of the surface area heuristic (Wald, On fast construction of SAH-based bounding volume hierarchies, 2007).
const BINS: usize = 16;
/// Deepest tree; below, nodes are halved by count, so that no input exceeds it.
pub(crate) const MAX_DEPTH: usize = 64;

/// Two children with their boxes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    pub min: [[f32; 3]; 2],
    pub max: [[f32; 3]; 2],
    /// Number of a node, or of the first triangle of a leaf.
    pub child: [u32; 2],
    /// Triangles of a leaf, or 0 for a node.
    pub count: [u8; 2],
    /// Axis along which the children lie, the first one lower.
    pub axis: u8,
}

/// The tree; `order` gives the triangles in the order of its leaves.
#[derive(Debug, Default)]
pub(crate) struct Bvh {
    pub nodes: Vec<Node>,
    pub order: Vec<u32>,
}

/// A box.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    min: [f32; 3],
    max: [f32; 3],
}

impl Bounds {
    /// About a centre, rounded outward.
    pub fn about(centre: [f64; 3], half: [f64; 3]) -> Self {
        Self {
            min: [0, 1, 2].map(|k| ((centre[k] - half[k]) as f32).next_down()),
            max: [0, 1, 2].map(|k| ((centre[k] + half[k]) as f32).next_up()),
        }
    }

    const EMPTY: Self = Self { min: [f32::INFINITY; 3], max: [f32::NEG_INFINITY; 3] };

    fn add(&mut self, other: &Self) {
        for k in 0..3 {
            self.min[k] = self.min[k].min(other.min[k]);
            self.max[k] = self.max[k].max(other.max[k]);
        }
    }

    fn area(&self) -> f32 {
        let d = [0, 1, 2].map(|k| (self.max[k] - self.min[k]).max(0.0));
        d[0] * d[1] + d[1] * d[2] + d[2] * d[0]
    }
}

impl Bvh {
    /// Over triangles given by their corners.
    pub fn new(triangles: &[[[f32; 3]; 3]]) -> Self {
        let boxes: Vec<Bounds> = triangles
            .iter()
            .map(|t| Bounds {
                min: [0, 1, 2].map(|k| t[0][k].min(t[1][k]).min(t[2][k])),
                max: [0, 1, 2].map(|k| t[0][k].max(t[1][k]).max(t[2][k])),
            })
            .collect();
        let mut tree = Self::default();
        tree.build(&boxes);
        tree
    }

    /// Makes the tree anew, over boxes. Keeps its memory.
    pub fn build(&mut self, boxes: &[Bounds]) {
        let Self { nodes, order } = self;
        nodes.clear();
        order.clear();
        order.extend(0..boxes.len() as u32);
        if !order.is_empty() {
            // A root of one leaf has a second child that is empty.
            let mut node =
                Node { min: [[0.0; 3]; 2], max: [[0.0; 3]; 2], child: [0; 2], count: [0; 2], axis: 0 };
            nodes.push(node);
            let n = order.len();
            let (at, axis) = if n > 1 { split(boxes, order, 0) } else { (1, 0) };
            node.axis = axis;
            let (left, right) = order.split_at_mut(at);
            fill(nodes, &mut node, 0, boxes, left, 0, 1);
            fill(nodes, &mut node, 1, boxes, right, at, 1);
            nodes[0] = node;
        }
    }
}

/// Makes one child of `node` of the triangles `part`, which begin at `first` in the order.
fn fill(
    nodes: &mut Vec<Node>,
    node: &mut Node,
    side: usize,
    boxes: &[Bounds],
    part: &mut [u32],
    first: usize,
    depth: usize,
) {
    let mut bounds = Bounds::EMPTY;
    for &t in part.iter() {
        bounds.add(&boxes[t as usize]);
    }
    (node.min[side], node.max[side]) = (bounds.min, bounds.max);
    if part.len() <= LEAF {
        node.child[side] = first as u32;
        node.count[side] = part.len() as u8;
        if part.is_empty() {
            // Nothing is on this side: a box that every ray enters, with a triangle of the other side, which changes no hit.
            (node.min[side], node.max[side]) = ([f32::MAX; 3], [f32::MIN; 3]);
            node.count[side] = 1;
            node.child[side] = 0;
        }
        return;
    }
    let number = nodes.len();
    node.child[side] = number as u32;
    node.count[side] = 0;
    let (at, axis) = split(boxes, part, depth);
    let mut own = Node { min: [[0.0; 3]; 2], max: [[0.0; 3]; 2], child: [0; 2], count: [0; 2], axis };
    nodes.push(own);
    let (left, right) = part.split_at_mut(at);
    fill(nodes, &mut own, 0, boxes, left, first, depth + 1);
    fill(nodes, &mut own, 1, boxes, right, first + at, depth + 1);
    nodes[number] = own;
}

/// Puts `part` in two halves; where the second begins, and along which axis.
fn split(boxes: &[Bounds], part: &mut [u32], depth: usize) -> (usize, u8) {
    let middle = |t: u32, axis: usize| {
        let b = &boxes[t as usize];
        0.5 * b.min[axis] + 0.5 * b.max[axis]
    };
    let mut lo = [f32::INFINITY; 3];
    let mut hi = [f32::NEG_INFINITY; 3];
    for &t in part.iter() {
        for k in 0..3 {
            lo[k] = lo[k].min(middle(t, k));
            hi[k] = hi[k].max(middle(t, k));
        }
    }
    let widest = (0..3).fold(0, |a, k| if hi[k] - lo[k] > hi[a] - lo[a] { k } else { a });
    let half = |part: &mut [u32], axis: usize| {
        let at = part.len() / 2;
        part.select_nth_unstable_by(at, |a, b| middle(*a, axis).total_cmp(&middle(*b, axis)).then(a.cmp(b)));
        (at, axis as u8)
    };
    if depth + 24 > MAX_DEPTH {
        return half(part, widest);
    }
    let mut best = (f32::INFINITY, 0, 0);
    for axis in 0..3 {
        let scale = BINS as f32 / (hi[axis] - lo[axis]);
        if !scale.is_finite() {
            continue;
        }
        let mut bins = [(Bounds::EMPTY, 0usize); BINS];
        for &t in part.iter() {
            let bin = (((middle(t, axis) - lo[axis]) * scale) as usize).min(BINS - 1);
            bins[bin].0.add(&boxes[t as usize]);
            bins[bin].1 += 1;
        }
        let mut right = [(0.0f32, 0usize); BINS];
        let mut run = (Bounds::EMPTY, 0);
        for k in (1..BINS).rev() {
            run.0.add(&bins[k].0);
            run.1 += bins[k].1;
            right[k] = (run.0.area(), run.1);
        }
        let mut run = (Bounds::EMPTY, 0usize);
        for k in 1..BINS {
            run.0.add(&bins[k - 1].0);
            run.1 += bins[k - 1].1;
            if run.1 == 0 || right[k].1 == 0 {
                continue;
            }
            let cost = run.0.area() * run.1 as f32 + right[k].0 * right[k].1 as f32;
            if cost < best.0 {
                best = (cost, axis, k);
            }
        }
    }
    let (cost, axis, bin) = best;
    if !cost.is_finite() {
        return half(part, widest);
    }
    let scale = BINS as f32 / (hi[axis] - lo[axis]);
    part.sort_unstable_by_key(|t| {
        ((((middle(*t, axis) - lo[axis]) * scale) as usize).min(BINS - 1) >= bin, *t)
    });
    let at = part.partition_point(|t| (((middle(*t, axis) - lo[axis]) * scale) as usize).min(BINS - 1) < bin);
    (at, axis as u8)
}

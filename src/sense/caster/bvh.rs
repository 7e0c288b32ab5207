//! A tree of boxes over triangles or geoms, and the ways through it: of a packet of rays, and of what is near a point.

use super::lanes::{Lanes, Real, away_from_zero};

/// Most triangles of a leaf.
const LEAF: usize = 4;
/// Bins of the surface area heuristic (Wald, On fast construction of SAH-based bounding volume hierarchies, 2007).
const BINS: usize = 16;
/// Deepest tree; below, nodes are halved by count, so that no input exceeds it.
const MAX_DEPTH: usize = 64;

/// Two children with their boxes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    min: [[f32; 3]; 2],
    max: [[f32; 3]; 2],
    /// Number of a node, or of the first triangle of a leaf.
    child: [u32; 2],
    /// Triangles of a leaf, or 0 for a node.
    count: [u8; 2],
    /// Axis along which the children lie, the first one lower.
    axis: u8,
}

/// The tree; `order` gives the triangles in the order of its leaves.
#[derive(Debug, Default)]
pub(in super::super) struct Bvh {
    nodes: Vec<Node>,
    pub order: Vec<u32>,
}

/// A box.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Bounds {
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

    /// Hands numbers in `order` to `visit`, near ones first, as long as their box comes nearer to a point than `reach`;
    /// `visit` gives the new reach. Boxes that
    /// hold the point always come. A number may come twice.
    pub fn near(&self, at: [f64; 3], mut reach: f64, mut visit: impl FnMut(usize, f64) -> f64) {
        if self.nodes.is_empty() {
            return;
        }
        let distance = |node: &Node, side: usize| {
            let mut sum = 0.0;
            for k in 0..3 {
                let low = f64::from(node.min[side][k]) - at[k];
                let high = at[k] - f64::from(node.max[side][k]);
                let out = low.max(high).max(0.0);
                sum += out * out;
            }
            sum
        };
        let mut stack = [(0.0, 0u32, 0u8); MAX_DEPTH + 8];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (square, child, count) = stack[depth];
            // In a box that holds the point nothing is known of how deep it is.
            if square > 0.0 && !(reach > 0.0 && square < reach * reach) {
                continue;
            }
            if count > 0 {
                for k in child as usize..child as usize + count as usize {
                    reach = visit(k, reach);
                }
                continue;
            }
            let node = &self.nodes[child as usize];
            let near = [distance(node, 0), distance(node, 1)];
            let first = usize::from(near[1] < near[0]);
            // The tree is at most MAX_DEPTH deep.
            for side in [1 - first, first] {
                stack[depth] = (near[side], node.child[side], node.count[side]);
                depth += 1;
            }
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

/// One entry of the stack of a walk.
#[derive(Clone, Copy)]
pub(super) struct Waiting<L> {
    near: L,
    child: u32,
    count: u8,
}

/// The stack of walks, kept between packets.
pub(super) struct Stack<L>([Waiting<L>; MAX_DEPTH + 8]);

impl<L: Lanes> Stack<L> {
    #[inline(always)]
    pub fn new(like: L) -> Self {
        Self([Waiting { near: like, child: 0, count: 0 }; MAX_DEPTH + 8])
    }
}

/// What a leaf does with its triangles.
pub(super) trait Leaves<L: Lanes> {
    /// Tests triangles `first .. first + count` of the order; improves `best`.
    fn test(&self, first: usize, count: usize, best: &mut L);
}

/// Rays from one point, ready for tests against boxes.
pub(super) struct Slabs<L: Lanes> {
    inverse: [L; 3],
    /// Origin moved up, for lower faces, and down, for upper ones: boxes grow by what rounding may have taken.
    low: [L::Real; 3],
    high: [L::Real; 3],
    /// The leading ray runs towards lower coordinates.
    back: [bool; 3],
}

impl<L: Lanes> Slabs<L> {
    #[inline(always)]
    pub fn new(at: [L::Real; 3], d: [L; 3], pad: L::Real) -> Self {
        let one = d[0].lit(1.0);
        let zero = <L::Real as Real>::of(0.0);
        let inverse = [one / away_from_zero(d[0]), one / away_from_zero(d[1]), one / away_from_zero(d[2])];
        Self {
            inverse,
            low: [at[0] + pad, at[1] + pad, at[2] + pad],
            high: [at[0] - pad, at[1] - pad, at[2] - pad],
            back: [d[0].lane(0) < zero, d[1].lane(0) < zero, d[2].lane(0) < zero],
        }
    }

    /// The leading ray runs towards lower coordinates of an axis.
    #[inline(always)]
    pub fn runs_back(&self, axis: usize) -> bool {
        self.back[axis]
    }

    /// Where the rays enter a box, and which do before `best`.
    #[inline(always)]
    pub fn enter(&self, min: [L::Real; 3], max: [L::Real; 3], best: L) -> (L, L::Mask) {
        let like = self.inverse[0];
        let mut near = like.lit(0.0);
        let mut far = best;
        for k in 0..3 {
            let a = like.all(min[k] - self.low[k]) * self.inverse[k];
            let b = like.all(max[k] - self.high[k]) * self.inverse[k];
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        // A few roundings of the products.
        (near, near.le(far * like.lit(1.000_001)))
    }
}

impl Bvh {
    /// Walks a packet through the tree, near children first.
    #[inline(always)]
    pub(super) fn walk<L: Lanes, T: Leaves<L>>(
        &self,
        slabs: &Slabs<L>,
        leaves: &T,
        stack: &mut Stack<L>,
        best: &mut L,
    ) {
        if self.nodes.is_empty() {
            return;
        }
        let mut depth = 0;
        let mut child = 0u32;
        let mut count = 0u8;
        loop {
            if count > 0 {
                leaves.test(child as usize, count as usize, best);
            } else {
                let node = &self.nodes[child as usize];
                let first = usize::from(slabs.back[node.axis as usize]);
                let (_, in_a) = slabs.enter(wide::<L>(node.min[first]), wide::<L>(node.max[first]), *best);
                let second = 1 - first;
                let (near_b, in_b) =
                    slabs.enter(wide::<L>(node.min[second]), wide::<L>(node.max[second]), *best);
                let (a, b) = (L::any(in_a), L::any(in_b));
                if a {
                    if b {
                        // The tree is at most MAX_DEPTH deep.
                        stack.0[depth] =
                            Waiting { near: near_b, child: node.child[second], count: node.count[second] };
                        depth += 1;
                    }
                    (child, count) = (node.child[first], node.count[first]);
                    continue;
                }
                if b {
                    (child, count) = (node.child[second], node.count[second]);
                    continue;
                }
            }
            loop {
                if depth == 0 {
                    return;
                }
                depth -= 1;
                let next = &stack.0[depth];
                if L::any(next.near.lt(*best)) {
                    (child, count) = (next.child, next.count);
                    break;
                }
            }
        }
    }
}

#[inline(always)]
fn wide<L: Lanes>(v: [f32; 3]) -> [L::Real; 3] {
    [L::Real::of(f64::from(v[0])), L::Real::of(f64::from(v[1])), L::Real::of(f64::from(v[2]))]
}

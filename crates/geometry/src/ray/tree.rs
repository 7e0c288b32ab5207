//! The way of a packet of rays through a tree of boxes.

use super::lanes::{Lanes, Real, away_from_zero};
use crate::shape::bvh::{Bvh, MAX_DEPTH};

/// One entry of the stack of a walk.
#[derive(Clone, Copy)]
pub(crate) struct Waiting<L> {
    near: L,
    child: u32,
    count: u8,
}

/// The stack of walks, kept between packets.
pub(crate) struct Stack<L>([Waiting<L>; MAX_DEPTH + 8]);

impl<L: Lanes> Stack<L> {
    #[inline(always)]
    pub fn new(like: L) -> Self {
        Self([Waiting { near: like, child: 0, count: 0 }; MAX_DEPTH + 8])
    }
}

/// What a leaf does with its triangles.
pub(crate) trait Leaves<L: Lanes> {
    /// Tests triangles `first .. first + count` of the order; improves `best`.
    fn test(&self, first: usize, count: usize, best: &mut L);
}

/// Rays from one point, ready for tests against boxes.
pub(crate) struct Slabs<L: Lanes> {
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
    pub(crate) fn walk<L: Lanes, T: Leaves<L>>(
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

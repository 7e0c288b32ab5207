//! Packets of rays against other lanes and against single rays, among one geom of each type.

use std::io::Write;

use fearless_simd::Level;

use super::frame::{Buffers, Sink, cast_at, level};
use super::{DepthRule, RayFilter, RayPattern, Rays};
use crate::kind::GeomType;
use crate::quat;
use crate::query::Poses;
use crate::table::{GeomSource, ShapeSource, Table};

const ALL: RayFilter = RayFilter { groups: [true; 6], own_drone: None, own_body: None };

/// One geom of each type in a ring about the camera, and floors: the table, positions and rotations.
struct Ring {
    table: Table,
    pos: Vec<[f64; 3]>,
    mat: Vec<[f64; 9]>,
}

/// Rotation about x, then about the new y, degrees.
fn turned(x: f64, y: f64) -> [f64; 9] {
    let (a, b) = (0.5 * x.to_radians(), 0.5 * y.to_radians());
    let q = quat::mul([a.sin(), 0.0, 0.0, a.cos()], [0.0, b.sin(), 0.0, b.cos()]);
    let m = quat::matrix(q);
    std::array::from_fn(|k| m[k / 3][k % 3])
}

/// A torus about z: radius 1, radius 0.4 of its tube.
fn torus() -> (Vec<[f32; 3]>, Vec<[i32; 3]>) {
    let n = 24;
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    for i in 0..n {
        for j in 0..n {
            let angle = |k: i32| std::f64::consts::TAU * f64::from(k) / f64::from(n);
            let (u, v) = (angle(i), angle(j));
            let out = 1.0 + 0.4 * v.cos();
            vertices.push([out * u.cos(), out * u.sin(), 0.4 * v.sin()].map(|x| x as f32));
            let at = |i: i32, j: i32| (i % n) * n + j % n;
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1));
            faces.extend([[a, b, d], [a, d, c]]);
        }
    }
    (vertices, faces)
}

fn ring() -> Ring {
    let (vertices, faces) = torus();
    let heights: Vec<f32> = (0..20).map(|k| (k % 2) as f32).collect();
    let sizes = ShapeSource::Sizes;
    let mesh = ShapeSource::Mesh { vertices_m: &vertices, faces: &faces, hull: &[] };
    let field = ShapeSource::Hfield { n_row: 4, n_col: 5, size_m: [1.0, 1.0, 0.5, 0.1], data: &heights };
    let geoms = [
        (GeomType::Plane, [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], turned(0.0, 0.0), sizes),
        (GeomType::Plane, [2.0, 1.0, 1.0], [0.0, 0.0, -0.5], turned(10.0, 5.0), sizes),
        (GeomType::Sphere, [0.7, 0.0, 0.0], [3.0, 0.0, 0.0], turned(0.0, 0.0), sizes),
        (GeomType::Capsule, [0.3, 0.6, 0.0], [2.0, 2.0, 0.0], turned(20.0, 30.0), sizes),
        (GeomType::Ellipsoid, [0.3, 0.6, 0.5], [0.0, 3.0, 0.0], turned(20.0, 30.0), sizes),
        (GeomType::Cylinder, [0.4, 0.5, 0.0], [-2.0, 2.0, 0.0], turned(60.0, 5.0), sizes),
        (GeomType::Box, [0.4, 0.5, 0.6], [-3.0, 0.0, 0.0], turned(60.0, 5.0), sizes),
        (GeomType::Mesh, [0.0; 3], [-2.0, -2.0, 0.0], turned(0.0, 0.0), mesh),
        (GeomType::Hfield, [0.0; 3], [1.0, -3.0, -0.5], turned(20.0, 10.0), field),
    ];
    let sources = geoms.iter().map(|(kind, size_m, pos_m, mat, shape)| GeomSource {
        kind: *kind,
        size_m: *size_m,
        body: 0,
        drone: None,
        moves: false,
        group: 0,
        opaque: true,
        collides: false,
        aabb_m: [0.0; 6],
        bounding_radius_m: 0.0,
        margin_m: 0.0,
        pos_m: *pos_m,
        mat,
        shape: *shape,
    });
    let table = Table::new(sources, Vec::new(), 1e-6, None);
    Ring { table, pos: geoms.iter().map(|g| g.2).collect(), mat: geoms.iter().map(|g| g.3).collect() }
}

impl Ring {
    fn rays<'a>(&'a self, origin_m: [f64; 3], quat_xyzw: [f64; 4], pattern: &'a RayPattern) -> Rays<'a> {
        Rays {
            table: &self.table,
            poses: Poses { geom_pos_m: &self.pos, geom_mat: &self.mat, body_pos_m: &[[0.0; 3]], version: 1 },
            filter: &ALL,
            origin_m,
            frame: quat::matrix(quat_xyzw),
            pattern,
            rule: DepthRule { z_depth: false, near: 0.0, far: f32::INFINITY },
        }
    }
}

#[test]
fn a_normal_belongs_to_the_surface_whose_range_is_stated() {
    let ring = ring();
    let d = [-0.707_106_781_186_547_5, -0.707_106_781_186_547_5, 0.0];
    let pattern = RayPattern::new(&[d]).unwrap();
    let job = ring.rays([0.0, 0.0, 0.1], [0.0, 0.0, 0.0, 1.0], &pattern);
    let (range, geom) = shoot(level(), &job);
    assert_eq!(geom[0], 7, "the torus");
    let of = |range: f32| {
        let mut n = [[0.0; 3]];
        job.normals(&geom, &[range], &mut n);
        n[0]
    };
    let face = of(range[0]);
    let against = |n: [f32; 3]| -> f64 { (0..3).map(|k| -d[k] * f64::from(n[k])).sum() };
    assert!(against(face) > 0.05 && against(face) < 0.999, "{face:?}");
    // Where f32 met another part than f64, no triangle is made up.
    assert!((against(of(range[0] + 0.5)) - 1.0).abs() < 1e-6);
}

fn shoot(level: Level, job: &Rays) -> (Vec<f32>, Vec<i32>) {
    let (mut range, mut geom) = (vec![0.0; job.pattern.n], vec![0; job.pattern.n]);
    let mut sink = Sink { range: Some(&mut range), geom: Some(&mut geom), ..Sink::default() };
    cast_at(level, job, &mut Buffers::default(), &mut sink);
    (range, geom)
}

#[test]
fn avx2_and_avx512_give_the_same_bits_and_sse_nearly() {
    let ring = ring();
    let mut directions = Vec::new();
    for up in -30..=20 {
        for turn in 0..400 {
            let (u, t) = (f64::from(up) * 0.03, f64::from(turn) * 0.0157);
            directions.push([u.cos() * t.cos(), u.cos() * t.sin(), u.sin()]);
        }
    }
    let pattern = RayPattern::new(&directions).unwrap();
    let job = ring.rays([0.1, 0.2, 0.3], [0.1, 0.2, 0.3, 0.927_361_849_549_570_3], &pattern);
    let best = shoot(level(), &job);
    let seen: std::collections::BTreeSet<i32> = best.1.iter().copied().collect();
    assert_eq!(seen.len(), ring.table.geoms().len() + 1, "{seen:?}");
    let skip = |what: &str| {
        // Straight to the stream: what `eprintln` says in a test that passes is not shown.
        let _ = writeln!(std::io::stderr(), "skipped: {what}; this processor has {:?}", level());
    };
    if let (Some(_), Some(avx2)) = (level().as_avx512(), level().as_avx2()) {
        let other = shoot(Level::Avx2(avx2), &job);
        assert_eq!(best.1, other.1);
        let same = best.0.iter().zip(&other.0).all(|(a, b)| a.to_bits() == b.to_bits());
        assert!(same, "AVX2 against AVX-512");
    } else {
        skip("the same bits by AVX2 and AVX-512");
    }
    if let Some(sse) = level().as_sse2() {
        let other = shoot(Level::Sse2(sse), &job);
        let odd = best.1.iter().zip(&other.1).filter(|(a, b)| a != b).count();
        assert!(odd <= 1, "{odd} rays see another geom");
        for (k, (a, b)) in best.0.iter().zip(&other.0).enumerate() {
            if best.1[k] == other.1[k] && a.is_finite() {
                assert!((a - b).abs() < 2e-5 * a, "{a} {b}");
            }
        }
    } else {
        skip("nearly the same ranges by SSE");
    }
}

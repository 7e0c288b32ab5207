//! Small things that tests of scenes and senses share.

#![allow(dead_code, reason = "every program that includes this uses its own part of it")]

use propwash::random::Stream;
use propwash::scene::{Scene, SceneSource, Shell};

/// A scene from its text, with drones.
pub fn build(xml: &str, shells: &[Shell]) -> Scene {
    Scene::build(&SceneSource::text("test", xml), shells).unwrap()
}

/// A direction, all alike.
pub fn random_unit(s: &mut Stream) -> [f64; 3] {
    loop {
        let v = [s.normal(), s.normal(), s.normal()];
        let n = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        if n > 0.1 {
            return v.map(|x| x / n);
        }
    }
}

/// A rotation xyzw, all alike.
pub fn random_quat(s: &mut Stream) -> [f64; 4] {
    loop {
        let q = [s.normal(), s.normal(), s.normal(), s.normal()];
        let n = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        if n > 0.1 {
            return q.map(|x| x / n);
        }
    }
}

//! Lets the compiled module find the libmujoco of Python's package `mujoco`, which lies beside `propwash`.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-link-arg-cdylib=-Wl,-rpath,$ORIGIN/../mujoco");
}

//! Lets the linker find the top-level memory.x, from whichever directory the build is started.

fn main() {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    println!("cargo::rustc-link-search={root}");
    println!("cargo::rerun-if-changed={root}/memory.x");
}

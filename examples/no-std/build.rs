//! Lets the linker find the workspace's memory.x.

fn main() {
    println!("cargo::rustc-link-search={}/../..", env!("CARGO_MANIFEST_DIR"));
}

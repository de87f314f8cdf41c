//! Lets the linker find the top-level memory.x, from whichever directory the build is started; and says so if the image
//! will not be the same as another machine's.

use std::path::Path;

fn main() {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    println!("cargo::rustc-link-search={root}");
    println!("cargo::rerun-if-changed={root}/memory.x");

    println!("cargo::rerun-if-env-changed=RUSTC");
    let compiler = std::env::var_os("RUSTC").and_then(|path| Path::new(&path).canonicalize().ok());
    if compiler != Path::new(root).join(".cargo/rustc").canonicalize().ok() {
        println!(
            "cargo::warning=RUSTC is not .cargo/rustc: paths of this machine get into the image, and its bytes cannot \
             be compared with another machine's"
        );
    }
}

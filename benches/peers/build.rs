//! Looks for Embree 3. Without it the program builds all the same and says at run time what to install.

use std::env;
use std::path::{Path, PathBuf};

fn main() {
    println!("cargo::rustc-check-cfg=cfg(embree)");
    println!("cargo::rerun-if-env-changed=EMBREE_LIB_DIR");
    let folders = env::var_os("EMBREE_LIB_DIR").map(PathBuf::from).into_iter().chain(
        [
            "/usr/lib/x86_64-linux-gnu",
            "/usr/lib/aarch64-linux-gnu",
            "/usr/lib64",
            "/usr/lib",
            "/usr/local/lib",
            "/opt/homebrew/lib",
        ]
        .map(PathBuf::from),
    );
    let has_embree =
        |folder: &Path| ["libembree3.so", "libembree3.dylib"].iter().any(|file| folder.join(file).exists());
    for folder in folders {
        // Installing it later must be noticed.
        println!("cargo::rerun-if-changed={}", folder.join("libembree3.so").display());
        if has_embree(&folder) {
            println!("cargo::rustc-cfg=embree");
            println!("cargo::rustc-link-search=native={}", folder.display());
            println!("cargo::rustc-link-lib=dylib=embree3");
            return;
        }
    }
}

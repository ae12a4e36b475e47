//! Builds the one piece of C: the logger of FMI 2.0.

fn main() {
    println!("cargo::rerun-if-changed=src/fmi/log2.c");
    cc::Build::new().file("src/fmi/log2.c").warnings_into_errors(true).compile("fmi2_log");
}

//! For tests of what happens where the system gives no more threads.

/// Runs `test`, which is the body of the test of that name, in a process of its own whose threads want stacks that no system has.
pub(crate) fn without_threads(name: &str, test: impl FnOnce()) {
    const CHILD: &str = "OUTCROP_TEST_WITHOUT_THREADS";
    if std::env::var_os(CHILD).is_some() {
        return test();
    }
    let mut child = std::process::Command::new(std::env::current_exe().unwrap());
    // With one test thread, tests run on the main thread.
    child.args([name, "--exact", "--test-threads=1"]);
    let output = child.env(CHILD, "1").env("RUST_MIN_STACK", (1u64 << 60).to_string()).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && text.contains("1 passed"), "{text}");
}

//! The `omnidrones` command.

fn main() -> std::process::ExitCode {
    omnidrones_cli::main()
}

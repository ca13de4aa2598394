//! Errors in the words of the command line: flags for arguments, and the exit code of each cause.

use trimip_core::{Advice, Error, ErrorKind, Origin, Place};

/// Returns the exit code of an error: 1 the run failed, 2 the input is wrong, 3 the device failed, 130 the user stopped the program.
pub fn exit_code(error: &Error) -> u8 {
    match error.kind() {
        ErrorKind::Input => 2,
        ErrorKind::Device => 3,
        ErrorKind::Stopped => crate::interrupt::EXIT_CODE,
        _ => 1,
    }
}

/// Formats the error as one line.
pub fn text(error: &Error) -> String {
    error.text_with(place, advice)
}

fn place(place: &Place) -> String {
    match place {
        Place::Argument { .. } => format!("--{place}"),
        Place::Setting { path, value, origin: Origin::CommandLine } => format!("--set: {path} = {value}"),
        _ => place.to_string(),
    }
}

fn advice(what: &Advice) -> String {
    match what {
        Advice::StartOver => "give --fresh to start the run over".into(),
        Advice::OtherFolder => "choose another --out folder".into(),
        Advice::Argument(text) => text.replace('{', "--").replace('}', ""),
        Advice::AnyOf(several) => several.iter().map(advice).collect::<Vec<_>>().join(", or "),
        _ => what.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_flags_and_causes_exit_codes() {
        let several = Advice::AnyOf(vec![Advice::StartOver, Advice::OtherFolder]);
        let error = Error::input(Place::argument("up", "0,0,0"), "has no direction", several);
        assert_eq!(
            text(&error),
            "--up 0,0,0: has no direction; give --fresh to start the run over, or choose another --out folder"
        );
        let path = Place::Setting { path: "a.b".into(), value: "3".into(), origin: Origin::CommandLine };
        let error = Error::input(path, "out of range", Advice::Argument("use {turntable} or {path}".into()));
        assert_eq!(text(&error), "--set: a.b = 3: out of range; use --turntable or --path");
        let errors = [Error::run("a"), error, Error::device("b"), Error::stopped()];
        assert_eq!(errors.each_ref().map(exit_code), [1, 2, 3, 130]);
    }
}

//! Scripts of timed commands, for tests and unattended runs.
//!
//! One step per line; `#` starts a comment. Times are in seconds.
//!
//! | line | meaning |
//! | --- | --- |
//! | `[+SECONDS] COMMAND` | sends a session command, after a delay |
//! | `wait live [T]` | waits until all cameras are live |
//! | `wait contact [T]`, `wait no-contact [T]` | waits until all gels are in contact, or none |
//! | `wait fresh [T]` | waits until all cameras have a frame newer than the last capture |
//! | `wait saved [T]` | waits until the last command is on disk; a rejection ends the script |
//! | `sleep S` | waits |
//! | `expect saved`, `expect refused` | required result of the last command |
//! | `stop-on-refusal` | a rejected command ends the script from here on |
//!
//! `T` is the time limit, by default 30 s.

use std::fmt;

use gripcast_base::error::{Error, Result};

const DEFAULT_TIMEOUT_S: f64 = 30.0;
const MAX_S: f64 = 86_400.0;
const FORMS: &str = "[+SECONDS] COMMAND, wait live|contact|no-contact|fresh|saved [SECONDS], sleep \
                     SECONDS, expect saved|refused, stop-on-refusal";

/// Result of a session command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Done; its files are on disk.
    Saved,
    /// Rejected or failed, with the reason.
    Refused(String),
}

/// Conditions that a script waits for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Conditions {
    /// All cameras of the rig deliver frames.
    pub all_live: bool,
    /// Contact on the gels; `None` until there are frames newer than the last capture.
    pub contact: Option<bool>,
    /// All cameras have an undamaged frame newer than the last capture.
    pub fresh: bool,
    /// A save is in progress.
    pub saving: bool,
    /// Result of the script's last command.
    pub last_answer: Option<Answer>,
}

/// Next action of a script.
#[derive(Debug)]
pub enum ScriptAction {
    /// Send this command.
    Command(String),
    /// Nothing yet.
    Wait,
    /// The script has ended.
    Done,
    /// A step failed; the script has ended.
    Failed(Error),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Condition {
    Live,
    Contact,
    NoContact,
    Fresh,
    Saved,
}

#[derive(Clone, Debug, PartialEq)]
enum Step {
    Command { delay_ns: u64, text: String },
    Wait { condition: Condition, limit_ns: u64 },
    Sleep { pause_ns: u64 },
    Expect { is_rejected: bool },
    StopOnRefusal,
}

#[derive(Clone, Debug, PartialEq)]
struct Line {
    number: usize,
    text: String,
    step: Step,
}

/// A parsed script.
#[derive(Clone, Debug, PartialEq)]
pub struct Script {
    file: String,
    lines: Vec<Line>,
}

impl Script {
    /// Parses the `text` of `file`; `check` validates session commands.
    ///
    /// # Errors
    /// `Input` with file, line, text and the expected forms.
    pub fn parse(
        text: &str,
        file: impl fmt::Display,
        check: &dyn Fn(&str) -> Result<(), String>,
    ) -> Result<Self> {
        let file = file.to_string();
        let mut lines = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let code = line.split('#').next().unwrap_or_default().trim();
            if code.is_empty() {
                continue;
            }
            let number = index + 1;
            let step = parse_step(code, check).map_err(|problem| {
                Error::input(format!("`{code}`: {problem}"))
                    .at(format!("{file}:{number}"))
                    .remedy(format!("use one of {FORMS}"))
            })?;
            lines.push(Line {
                number,
                text: code.to_owned(),
                step,
            });
        }
        if lines.is_empty() {
            return Err(Error::input("the script has no steps").at(file));
        }
        Ok(Self { file, lines })
    }

    /// Number of steps.
    pub fn len(&self) -> usize {
        self.lines.len()
    }

    /// Whether there are no steps; false for a parsed script.
    pub fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }
}

fn parse_step(code: &str, check: &dyn Fn(&str) -> Result<(), String>) -> Result<Step, String> {
    let words: Vec<&str> = code.split_whitespace().collect();
    match words.as_slice() {
        ["wait", what, limit @ ..] if limit.len() <= 1 => {
            let condition = match *what {
                "live" => Condition::Live,
                "contact" => Condition::Contact,
                "no-contact" => Condition::NoContact,
                "fresh" => Condition::Fresh,
                "saved" => Condition::Saved,
                _ => {
                    return Err(format!(
                        "unknown condition `{what}`, expected live, contact, no-contact, fresh or \
                         saved"
                    ));
                }
            };
            let limit_ns = match limit.first() {
                Some(text) => seconds(text)?,
                None => seconds_to_ns(DEFAULT_TIMEOUT_S),
            };
            Ok(Step::Wait {
                condition,
                limit_ns,
            })
        }
        ["sleep", pause] => Ok(Step::Sleep {
            pause_ns: seconds(pause)?,
        }),
        ["expect", "saved"] => Ok(Step::Expect { is_rejected: false }),
        ["expect", "refused"] => Ok(Step::Expect { is_rejected: true }),
        ["stop-on-refusal"] => Ok(Step::StopOnRefusal),
        ["wait" | "sleep" | "expect" | "stop-on-refusal", ..] => {
            Err("invalid arguments".to_owned())
        }
        _ => {
            let (delay_ns, text) = match code.strip_prefix('+') {
                Some(rest) => {
                    let (delay, text) = rest
                        .split_once(char::is_whitespace)
                        .ok_or("expected a command after the delay")?;
                    (seconds(delay)?, text.trim())
                }
                None => (0, code),
            };
            check(text)?;
            Ok(Step::Command {
                delay_ns,
                text: text.to_owned(),
            })
        }
    }
}

fn seconds(text: &str) -> Result<u64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.0..=MAX_S).contains(&value) => Ok(seconds_to_ns(value)),
        _ => Err(format!(
            "invalid time `{text}`, expected 0 to 86400 seconds"
        )),
    }
}

fn seconds_to_ns(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

/// Runs a script by polling.
#[derive(Debug)]
pub struct ScriptRunner {
    script: Script,
    next: usize,
    step_began_ns: Option<u64>,
    stop_on_refusal: bool,
    command: Option<usize>,
    failed: bool,
}

impl ScriptRunner {
    /// Starts at the first step of `script`.
    pub fn new(script: Script) -> Self {
        Self {
            script,
            next: 0,
            step_began_ns: None,
            stop_on_refusal: false,
            command: None,
            failed: false,
        }
    }

    /// Action at `now_ns`; `Done` after `Failed`.
    ///
    /// After a `Command`, the caller clears [`Conditions::last_answer`] until the session has
    /// answered.
    pub fn next(&mut self, now_ns: u64, conditions: &Conditions) -> ScriptAction {
        loop {
            if self.failed {
                return ScriptAction::Done;
            }
            if self.stop_on_refusal
                && let Some(Answer::Refused(reason)) = &conditions.last_answer
                && !self.expects_rejection()
            {
                return self.fail_command(&format!("the command was rejected: {reason}"));
            }
            let Some(line) = self.script.lines.get(self.next).cloned() else {
                return ScriptAction::Done;
            };
            let began_ns = *self.step_began_ns.get_or_insert(now_ns);
            let elapsed_ns = now_ns.saturating_sub(began_ns);
            match line.step {
                Step::Command { delay_ns, text } => {
                    if elapsed_ns < delay_ns {
                        return ScriptAction::Wait;
                    }
                    self.command = Some(self.next);
                    self.advance();
                    return ScriptAction::Command(text);
                }
                Step::Sleep { pause_ns } => {
                    if elapsed_ns < pause_ns {
                        return ScriptAction::Wait;
                    }
                }
                Step::StopOnRefusal => self.stop_on_refusal = true,
                Step::Wait {
                    condition,
                    limit_ns,
                } => {
                    if condition == Condition::Saved
                        && let Some(Answer::Refused(reason)) = &conditions.last_answer
                    {
                        return self.fail_command(&format!("the command was rejected: {reason}"));
                    }
                    let is_met = match condition {
                        Condition::Live => conditions.all_live,
                        Condition::Contact => conditions.contact == Some(true),
                        Condition::NoContact => conditions.contact == Some(false),
                        Condition::Fresh => conditions.fresh,
                        Condition::Saved => {
                            !conditions.saving && conditions.last_answer == Some(Answer::Saved)
                        }
                    };
                    if !is_met {
                        if elapsed_ns < limit_ns {
                            return ScriptAction::Wait;
                        }
                        let limit_s = limit_ns as f64 / 1e9;
                        return self.fail(&line, &format!("no result within {limit_s} s"));
                    }
                }
                Step::Expect { is_rejected } => match &conditions.last_answer {
                    None if elapsed_ns < seconds_to_ns(DEFAULT_TIMEOUT_S) => {
                        return ScriptAction::Wait;
                    }
                    None => {
                        let problem = format!("no result within {DEFAULT_TIMEOUT_S} s");
                        return self.fail(&line, &problem);
                    }
                    Some(Answer::Saved) if is_rejected => {
                        return self.fail(&line, "the command was not rejected");
                    }
                    Some(Answer::Refused(reason)) if !is_rejected => {
                        return self.fail(&line, &format!("the command was rejected: {reason}"));
                    }
                    Some(_) => {}
                },
            }
            self.advance();
        }
    }

    /// Number of completed and of all steps.
    pub fn progress(&self) -> (usize, usize) {
        (self.next, self.script.len())
    }

    fn advance(&mut self) {
        self.next += 1;
        self.step_began_ns = None;
    }

    fn expects_rejection(&self) -> bool {
        let expects_rejection = |step: usize| {
            let line = self.script.lines.get(step);
            line.is_some_and(|line| line.step == Step::Expect { is_rejected: true })
        };
        expects_rejection(self.next) || self.command.is_some_and(|step| expects_rejection(step + 1))
    }

    fn fail_command(&mut self, problem: &str) -> ScriptAction {
        let line = self.command.unwrap_or(self.next);
        match self.script.lines.get(line).cloned() {
            Some(line) => self.fail(&line, problem),
            None => ScriptAction::Done,
        }
    }

    fn fail(&mut self, line: &Line, problem: &str) -> ScriptAction {
        self.failed = true;
        ScriptAction::Failed(
            Error::input(format!("`{}`: {problem}", line.text))
                .at(format!("{}:{}", self.script.file, line.number)),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    fn check(text: &str) -> Result<(), String> {
        if ["trigger", "stable", "undo", "object mug"].contains(&text) {
            Ok(())
        } else {
            Err(format!("unknown command `{text}`"))
        }
    }

    fn runner(text: &str) -> ScriptRunner {
        ScriptRunner::new(Script::parse(text, "demo.txt", &check).unwrap())
    }

    fn live() -> Conditions {
        Conditions {
            all_live: true,
            ..Conditions::default()
        }
    }

    fn answered(answer: Answer) -> Conditions {
        Conditions {
            last_answer: Some(answer),
            ..live()
        }
    }

    fn command(action: ScriptAction) -> String {
        match action {
            ScriptAction::Command(text) => text,
            other => panic!("expected a command, got {other:?}"),
        }
    }

    fn failure(action: ScriptAction) -> String {
        match action {
            ScriptAction::Failed(error) => {
                assert_eq!(error.kind().exit_code(), 1);
                error.to_string()
            }
            other => panic!("expected a failure, got {other:?}"),
        }
    }

    #[test]
    fn commands_are_sent_after_their_delays() {
        let mut runner = runner("# three\nobject mug\n\n+0.5 trigger # now\nsleep 1\n stable\n");
        assert_eq!(command(runner.next(0, &live())), "object mug");
        assert!(matches!(runner.next(0, &live()), ScriptAction::Wait));
        assert!(matches!(
            runner.next(S / 2 - 1, &live()),
            ScriptAction::Wait
        ));
        assert_eq!(command(runner.next(S / 2, &live())), "trigger");
        assert!(matches!(runner.next(S, &live()), ScriptAction::Wait));
        assert_eq!(command(runner.next(2 * S, &live())), "stable");
        assert!(matches!(runner.next(2 * S, &live()), ScriptAction::Done));
        assert_eq!(runner.progress(), (4, 4));
    }

    #[test]
    fn waits_end_when_their_condition_is_met() {
        let mut runner = runner("wait live\nwait contact\nwait no-contact\ntrigger\nwait saved");
        let mut now = Conditions::default();
        assert!(matches!(runner.next(0, &now), ScriptAction::Wait));
        now.all_live = true;
        assert!(matches!(runner.next(1, &now), ScriptAction::Wait));
        assert_eq!(runner.progress().0, 1);
        now.contact = Some(true);
        assert!(matches!(runner.next(2, &now), ScriptAction::Wait));
        assert_eq!(runner.progress().0, 2);
        now.contact = Some(false);
        assert_eq!(command(runner.next(3, &now)), "trigger");
        assert!(matches!(runner.next(4, &now), ScriptAction::Wait));
        now.last_answer = Some(Answer::Saved);
        now.saving = true;
        assert!(matches!(runner.next(5, &now), ScriptAction::Wait));
        now.saving = false;
        assert!(matches!(runner.next(6, &now), ScriptAction::Done));
    }

    #[test]
    fn a_wait_has_a_limit_that_starts_with_it() {
        let mut runner = runner("sleep 5\nwait contact 2");
        assert!(matches!(runner.next(0, &live()), ScriptAction::Wait));
        assert!(matches!(runner.next(5 * S, &live()), ScriptAction::Wait));
        assert!(matches!(
            runner.next(7 * S - 1, &live()),
            ScriptAction::Wait
        ));
        assert_eq!(
            failure(runner.next(7 * S, &live())),
            "demo.txt:2: `wait contact 2`: no result within 2 s"
        );
        assert!(matches!(runner.next(8 * S, &live()), ScriptAction::Done));
    }

    #[test]
    fn expectations_are_checked() {
        let rejected = || answered(Answer::Refused("no contact".to_owned()));
        let mut good = runner("trigger\nexpect refused\ntrigger\nexpect saved");
        assert_eq!(command(good.next(0, &live())), "trigger");
        assert!(matches!(good.next(1, &live()), ScriptAction::Wait));
        assert_eq!(command(good.next(2, &rejected())), "trigger");
        assert!(matches!(
            good.next(3, &answered(Answer::Saved)),
            ScriptAction::Done
        ));

        let mut bad = runner("trigger\nexpect saved");
        assert_eq!(command(bad.next(0, &live())), "trigger");
        let text = failure(bad.next(1, &rejected()));
        assert!(
            text.contains("demo.txt:2") && text.contains("no contact"),
            "{text}"
        );

        let mut accepted = runner("trigger\nexpect refused");
        assert_eq!(command(accepted.next(0, &live())), "trigger");
        let text = failure(accepted.next(1, &answered(Answer::Saved)));
        assert!(text.contains("not rejected"), "{text}");

        let mut silent = runner("trigger\nexpect saved");
        assert_eq!(command(silent.next(0, &live())), "trigger");
        assert!(matches!(silent.next(S, &live()), ScriptAction::Wait));
        assert!(failure(silent.next(31 * S, &live())).contains("no result"));
    }

    #[test]
    fn rejection_ends_a_wait_and_a_strict_script() {
        let rejected = answered(Answer::Refused("stale frame".to_owned()));
        let mut waiting = runner("object mug\ntrigger\nwait saved");
        assert_eq!(command(waiting.next(0, &live())), "object mug");
        assert_eq!(command(waiting.next(0, &live())), "trigger");
        assert_eq!(
            failure(waiting.next(1, &rejected)),
            "demo.txt:2: `trigger`: the command was rejected: stale frame"
        );

        let mut strict = runner("stop-on-refusal\ntrigger\nsleep 1\nundo");
        assert_eq!(command(strict.next(0, &live())), "trigger");
        assert!(failure(strict.next(1, &rejected)).contains("demo.txt:2"));

        let mut expecting = runner("stop-on-refusal\ntrigger\nexpect refused\nundo");
        assert_eq!(command(expecting.next(0, &live())), "trigger");
        assert!(matches!(expecting.next(1, &live()), ScriptAction::Wait));
        assert_eq!(command(expecting.next(2, &rejected)), "undo");
    }

    #[test]
    fn errors_name_file_line_text_and_expected_forms() {
        for (line, expected) in [
            ("jump", "unknown command `jump`"),
            ("+x trigger", "invalid time `x`"),
            ("+2", "expected a command"),
            ("+-1 trigger", "invalid time"),
            ("wait rain", "unknown condition `rain`"),
            ("wait", "invalid arguments"),
            ("wait live 1 2", "invalid arguments"),
            ("wait live nan", "invalid time"),
            ("sleep 1e9", "invalid time"),
            ("expect rain", "invalid arguments"),
        ] {
            let error = Script::parse(&format!("trigger\n{line}"), "demo.txt", &check).unwrap_err();
            let text = error.to_string();
            assert!(text.starts_with("demo.txt:2: `"), "{text}");
            assert!(text.contains(expected), "{text}");
            assert!(text.contains("wait live|contact"), "{text}");
        }
        let empty = Script::parse("# nothing\n", "demo.txt", &check).unwrap_err();
        assert!(empty.to_string().contains("no steps"));
    }
}

//! Scripts of timed commands, for tests and unattended runs.
//!
//! One step a line; `#` begins a comment. Times are in seconds.
//!
//! | line | meaning |
//! | --- | --- |
//! | `[+SECONDS] COMMAND` | gives a session command, after a pause |
//! | `wait live [T]` | until every camera is live |
//! | `wait contact [T]`, `wait no-contact [T]` | until the gels are touched, or not |
//! | `wait fresh [T]` | until every camera has a frame newer than the last capture |
//! | `wait saved [T]` | until the last command is on disk; a refusal ends the script |
//! | `sleep S` | pause |
//! | `expect saved`, `expect refused` | what the last command must be answered with |
//! | `stop-on-refusal` | from here on a refused command ends the script |
//!
//! `T` is the time limit, 30 s unless given.

use std::fmt;

use gripcast_base::error::{Error, Result};

const DEFAULT_TIMEOUT_S: f64 = 30.0;
const MAX_S: f64 = 86_400.0;
const FORMS: &str = "[+SECONDS] COMMAND, wait live|contact|no-contact|fresh|saved [SECONDS], sleep \
                     SECONDS, expect saved|refused, stop-on-refusal";

/// What the session answered to a command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// It is done; what it writes is on disk.
    Saved,
    /// It was refused or failed, for these reasons.
    Refused(String),
}

/// What a script can wait for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Conditions {
    /// Every camera of the rig delivers frames.
    pub all_live: bool,
    /// Whether the gels are touched; `None` until frames newer than the last capture tell.
    pub contact: Option<bool>,
    /// Every camera has a good frame newer than the last capture.
    pub fresh: bool,
    /// A save is under way.
    pub saving: bool,
    /// The answer to the script's newest command; `None` until it is there.
    pub last_answer: Option<Answer>,
}

/// What to do next.
#[derive(Debug)]
pub enum ScriptAction {
    /// Give this command now.
    Command(String),
    /// Nothing yet; ask again soon.
    Wait,
    /// The script has ended.
    Done,
    /// A step did not hold; the script has ended.
    Failed(Error),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Awaited {
    Live,
    Contact,
    NoContact,
    Fresh,
    Saved,
}

impl Awaited {
    const ALL: [Self; 5] = [
        Self::Live,
        Self::Contact,
        Self::NoContact,
        Self::Fresh,
        Self::Saved,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Live => "live",
            Self::Contact => "contact",
            Self::NoContact => "no-contact",
            Self::Fresh => "fresh",
            Self::Saved => "saved",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Expected {
    Saved,
    Refused,
}

#[derive(Clone, Debug, PartialEq)]
enum Step {
    Command { delay_ns: u64, text: String },
    Wait { awaited: Awaited, limit_ns: u64 },
    Sleep { pause_ns: u64 },
    Expect(Expected),
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
    place: String,
    lines: Vec<Line>,
}

impl Script {
    /// Parses the `text` of the file `place`; `check` says why a text is no session command.
    ///
    /// # Errors
    /// [`ErrorKind::Input`] with file, line, text and what is expected.
    pub fn parse(
        text: &str,
        place: impl fmt::Display,
        check: &dyn Fn(&str) -> Result<(), String>,
    ) -> Result<Self> {
        let place = place.to_string();
        let mut lines = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let code = line.split('#').next().unwrap_or_default().trim();
            if code.is_empty() {
                continue;
            }
            let number = index + 1;
            let step = parse_step(code, check).map_err(|problem| {
                Error::input(format!("`{code}`: {problem}"))
                    .at(format!("{place}:{number}"))
                    .remedy(format!("a line is one of {FORMS}"))
            })?;
            lines.push(Line {
                number,
                text: code.to_owned(),
                step,
            });
        }
        if lines.is_empty() {
            return Err(Error::input("the script has no steps").at(place));
        }
        Ok(Self { place, lines })
    }

    /// Number of steps.
    pub fn len(&self) -> usize {
        self.lines.len()
    }

    /// Whether there are no steps; never true of a parsed script.
    pub fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }
}

fn parse_step(code: &str, check: &dyn Fn(&str) -> Result<(), String>) -> Result<Step, String> {
    let words: Vec<&str> = code.split_whitespace().collect();
    match words.as_slice() {
        ["wait", what, limit @ ..] if limit.len() <= 1 => {
            let awaited = Awaited::ALL
                .into_iter()
                .find(|awaited| awaited.name() == *what)
                .ok_or_else(|| {
                    format!(
                        "`{what}` cannot be waited for; expected live, contact, no-contact, fresh or saved"
                    )
                })?;
            let limit_ns = match limit.first() {
                Some(text) => seconds(text)?,
                None => seconds_to_ns(DEFAULT_TIMEOUT_S),
            };
            Ok(Step::Wait { awaited, limit_ns })
        }
        ["sleep", pause] => Ok(Step::Sleep {
            pause_ns: seconds(pause)?,
        }),
        ["expect", "saved"] => Ok(Step::Expect(Expected::Saved)),
        ["expect", "refused"] => Ok(Step::Expect(Expected::Refused)),
        ["stop-on-refusal"] => Ok(Step::StopOnRefusal),
        ["wait" | "sleep" | "expect" | "stop-on-refusal", ..] => {
            Err("this step has another form".to_owned())
        }
        _ => {
            let (delay_ns, text) = match code.strip_prefix('+') {
                Some(rest) => {
                    let (delay, text) = rest
                        .split_once(char::is_whitespace)
                        .ok_or("a command is expected after the pause")?;
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
        _ => Err(format!("`{text}` is no time; expected 0 to 86400 seconds")),
    }
}

fn seconds_to_ns(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

/// Plays a script: asked again and again, it says what to do next.
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
    /// A runner at the first step of `script`.
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

    /// What to do at `now_ns`. After `Done` or `Failed` the answer is `Done`.
    ///
    /// After a `Command` the caller clears [`Conditions::last_answer`] until the session has
    /// answered that command.
    pub fn next(&mut self, now_ns: u64, conditions: &Conditions) -> ScriptAction {
        loop {
            if self.failed {
                return ScriptAction::Done;
            }
            if self.stop_on_refusal
                && let Some(Answer::Refused(reason)) = &conditions.last_answer
                && !self.expects_refusal()
            {
                return self.fail_command(&format!("was refused: {reason}"));
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
                Step::Wait { awaited, limit_ns } => {
                    if awaited == Awaited::Saved
                        && let Some(Answer::Refused(reason)) = &conditions.last_answer
                    {
                        return self.fail_command(&format!("was refused: {reason}"));
                    }
                    let holds = match awaited {
                        Awaited::Live => conditions.all_live,
                        Awaited::Contact => conditions.contact == Some(true),
                        Awaited::NoContact => conditions.contact == Some(false),
                        Awaited::Fresh => conditions.fresh,
                        Awaited::Saved => {
                            !conditions.saving && conditions.last_answer == Some(Answer::Saved)
                        }
                    };
                    if !holds {
                        if elapsed_ns < limit_ns {
                            return ScriptAction::Wait;
                        }
                        let limit_s = limit_ns as f64 * 1e-9;
                        return self.fail(&line, &format!("did not happen within {limit_s} s"));
                    }
                }
                Step::Expect(expected) => match (&conditions.last_answer, expected) {
                    (None, _) if elapsed_ns < seconds_to_ns(DEFAULT_TIMEOUT_S) => {
                        return ScriptAction::Wait;
                    }
                    (None, _) => {
                        return self
                            .fail(&line, &format!("no answer within {DEFAULT_TIMEOUT_S} s"));
                    }
                    (Some(Answer::Saved), Expected::Saved)
                    | (Some(Answer::Refused(_)), Expected::Refused) => {}
                    (Some(Answer::Saved), Expected::Refused) => {
                        return self.fail(&line, "the command was not refused");
                    }
                    (Some(Answer::Refused(reason)), Expected::Saved) => {
                        let reason = reason.clone();
                        return self.fail(&line, &format!("the command was refused: {reason}"));
                    }
                },
            }
            self.advance();
        }
    }

    /// Steps that are done, and all steps.
    pub fn progress(&self) -> (usize, usize) {
        (self.next, self.script.len())
    }

    fn advance(&mut self) {
        self.next += 1;
        self.step_began_ns = None;
    }

    fn expects_refusal(&self) -> bool {
        let awaited = |step: usize| {
            self.script
                .lines
                .get(step)
                .is_some_and(|line| line.step == Step::Expect(Expected::Refused))
        };
        awaited(self.next) || self.command.is_some_and(|step| awaited(step + 1))
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
                .at(format!("{}:{}", self.script.place, line.number)),
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
            Err(format!("`{text}` is no command"))
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
    fn commands_come_in_order_after_their_pauses() {
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
    fn waits_end_when_their_condition_holds() {
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
            "demo.txt:2: `wait contact 2`: did not happen within 2 s"
        );
        assert!(matches!(runner.next(8 * S, &live()), ScriptAction::Done));
    }

    #[test]
    fn expectations_are_held_against_the_answer() {
        let refused = || answered(Answer::Refused("no contact".to_owned()));
        let mut good = runner("trigger\nexpect refused\ntrigger\nexpect saved");
        assert_eq!(command(good.next(0, &live())), "trigger");
        assert!(matches!(good.next(1, &live()), ScriptAction::Wait));
        assert_eq!(command(good.next(2, &refused())), "trigger");
        assert!(matches!(
            good.next(3, &answered(Answer::Saved)),
            ScriptAction::Done
        ));

        let mut bad = runner("trigger\nexpect saved");
        assert_eq!(command(bad.next(0, &live())), "trigger");
        let text = failure(bad.next(1, &refused()));
        assert!(
            text.contains("demo.txt:2") && text.contains("no contact"),
            "{text}"
        );

        let mut unrefused = runner("trigger\nexpect refused");
        assert_eq!(command(unrefused.next(0, &live())), "trigger");
        let text = failure(unrefused.next(1, &answered(Answer::Saved)));
        assert!(text.contains("not refused"), "{text}");

        let mut mute = runner("trigger\nexpect saved");
        assert_eq!(command(mute.next(0, &live())), "trigger");
        assert!(matches!(mute.next(S, &live()), ScriptAction::Wait));
        assert!(failure(mute.next(31 * S, &live())).contains("no answer"));
    }

    #[test]
    fn a_refusal_ends_a_wait_for_the_save_and_a_strict_script() {
        let refused = answered(Answer::Refused("stale frame".to_owned()));
        let mut waiting = runner("object mug\ntrigger\nwait saved");
        assert_eq!(command(waiting.next(0, &live())), "object mug");
        assert_eq!(command(waiting.next(0, &live())), "trigger");
        assert_eq!(
            failure(waiting.next(1, &refused)),
            "demo.txt:2: `trigger`: was refused: stale frame"
        );

        let mut strict = runner("stop-on-refusal\ntrigger\nsleep 1\nundo");
        assert_eq!(command(strict.next(0, &live())), "trigger");
        assert!(failure(strict.next(1, &refused)).contains("demo.txt:2"));

        let mut expecting = runner("stop-on-refusal\ntrigger\nexpect refused\nundo");
        assert_eq!(command(expecting.next(0, &live())), "trigger");
        assert!(matches!(expecting.next(1, &live()), ScriptAction::Wait));
        assert_eq!(command(expecting.next(2, &refused)), "undo");
    }

    #[test]
    fn mistakes_name_file_line_text_and_what_is_expected() {
        for (line, part) in [
            ("jump", "`jump` is no command"),
            ("+x trigger", "`x` is no time"),
            ("+2", "a command is expected"),
            ("+-1 trigger", "no time"),
            ("wait rain", "cannot be waited for"),
            ("wait", "another form"),
            ("wait live 1 2", "another form"),
            ("wait live nan", "no time"),
            ("sleep 1e9", "no time"),
            ("expect rain", "another form"),
        ] {
            let error = Script::parse(&format!("trigger\n{line}"), "demo.txt", &check).unwrap_err();
            let text = error.to_string();
            assert!(text.starts_with("demo.txt:2: `"), "{text}");
            assert!(text.contains(part), "{text}");
            assert!(text.contains("wait live|contact"), "{text}");
        }
        let empty = Script::parse("# nothing\n", "demo.txt", &check).unwrap_err();
        assert!(empty.to_string().contains("no steps"));
    }
}

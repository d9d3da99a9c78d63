//! Tests of commands that no longer fit the session.

use super::machine_test::{Store, good, handle, play, result, session};
use super::*;
use gripcast_dataset::Outcome;

const SECOND_NS: u64 = 1_000_000_000;

/// A command of a page that was given now.
fn remote(command: Command, seen: Seen) -> Request {
    Request {
        seen,
        ..Request::new(7, command, CommandSource::Remote)
    }
}

fn revision(session: &Session) -> u64 {
    session.view(0).revision
}

/// What a page saw that shows the session now.
fn current(session: &Session) -> Seen {
    Seen {
        revision: Some(revision(session)),
        ..Seen::default()
    }
}

/// Refuses a request, which changes nothing, and returns the reasons.
fn refused(session: &mut Session, request: Request) -> Vec<String> {
    let before = session.view(0);
    let now = good();
    let now = session.is_trigger(&request.command).then_some(&now);
    let effects = session.handle(request, now);
    assert_eq!(effects.len(), 1, "{effects:?}");
    assert_eq!(session.view(0), before);
    match result(&effects) {
        CommandResult::Refused {
            reasons,
            can_override: false,
            stale: true,
        } => reasons.clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn tap_on_a_state_that_has_passed_is_refused_and_changes_nothing() {
    let (mut session, mut store) = (session(), Store::default());
    let old = current(&session);
    play(&mut session, &mut store, Command::Trigger, &good());
    let reasons = refused(
        &mut session,
        Request {
            now_ns: 4 * SECOND_NS,
            ..remote(Command::Trigger, old)
        },
    );
    assert_eq!(
        reasons,
        ["the initial frame was saved 4.0 s ago; look at the step and press again"]
    );
    let step = Seen {
        step: Some(Step::Initial),
        ..Seen::default()
    };
    assert_eq!(
        refused(&mut session, remote(Command::Trigger, step)).len(),
        1
    );
    let seen = current(&session);
    let effects = session.handle(remote(Command::Trigger, seen), Some(&good()));
    assert!(matches!(effects[0], Effect::Store(_)), "{effects:?}");
}

#[test]
fn command_older_than_the_limit_is_refused() {
    let mut session = session();
    let old = |command, age_ms| Request {
        age_ms,
        ..remote(command, Seen::default())
    };
    assert_eq!(
        refused(&mut session, old(Command::Trigger, 13_000.0)),
        ["this command is 13 s old; the limit is 2.0 s"]
    );
    // A name means the same ten seconds later.
    let name = || Command::Object("cup".parse().unwrap());
    let effects = session.handle(old(name(), 10_000.0), None);
    assert_eq!(result(&effects), &CommandResult::Accepted);
    assert_eq!(
        refused(&mut session, old(name(), 31_000.0)),
        ["this command is 31 s old; the limit is 30 s"]
    );
    session.set_limits(GuardLimits {
        max_command_age_ms: 20_000.0,
        ..GuardLimits::default()
    });
    let effects = session.handle(
        old(Command::Initial, 13_000.0),
        Some(&Conditions::default()),
    );
    assert!(matches!(effects[0], Effect::Store(_)), "{effects:?}");
}

#[test]
fn old_key_is_refused_with_a_message_and_quit_never() {
    let mut session = session();
    let old = |command| Request {
        age_ms: 60_000.0,
        ..Request::new(7, command, CommandSource::Keyboard)
    };
    let effects = session.handle(old(Command::Trigger), Some(&good()));
    assert_eq!(effects[0], Effect::Tone(Tone::Refused));
    let message = session.view(0).message.unwrap().text;
    assert_eq!(
        message,
        "`trigger` NOT carried out: this command is 60 s old; the limit is 2.0 s"
    );
    let effects = session.handle(old(Command::Quit), None);
    assert_eq!(effects[0], Effect::Quit);
}

#[test]
fn undo_names_the_step_that_it_undoes() {
    let (mut session, mut store) = (session(), Store::default());
    play(&mut session, &mut store, Command::Trigger, &good());
    let seen = Seen {
        undo: session.view(0).undo,
        ..Seen::default()
    };
    play(&mut session, &mut store, Command::Trigger, &good());
    let grasp = session.view(0).undo.unwrap();
    assert_eq!(
        refused(&mut session, remote(Command::Undo, seen)),
        [format!("undo would now change {grasp}, not initial frame")]
    );
    let seen = Seen {
        redo: Some("grasp 7f3a".into()),
        ..Seen::default()
    };
    assert_eq!(
        refused(&mut session, remote(Command::Redo, seen)),
        ["redo would now change nothing, not grasp 7f3a"]
    );
    let seen = Seen {
        undo: Some(grasp),
        ..current(&session)
    };
    let effects = session.handle(remote(Command::Undo, seen), None);
    assert!(matches!(effects[0], Effect::Store(_)), "{effects:?}");
}

#[test]
fn label_of_a_named_grasp_fits_until_somebody_else_has_labelled_it() {
    let (mut session, mut store) = (session(), Store::default());
    for _ in 0..2 {
        play(&mut session, &mut store, Command::Trigger, &good());
    }
    let last = session.view(0).last.unwrap();
    let label = |outcome| {
        let seen = Seen {
            outcome: Some(last.outcome),
            ..Seen::default()
        };
        let command = Command::Relabel(last.id.clone(), outcome);
        Request {
            age_ms: 8_000.0,
            ..remote(command, seen)
        }
    };
    // The next grasp begins; the label still names its grasp.
    play(&mut session, &mut store, Command::Initial, &good());
    let effects = session.handle(label(Outcome::Stable), None);
    assert!(matches!(effects[0], Effect::Store(_)), "{effects:?}");
    session.completed(StoreReply::Labelled {
        id: last.id.clone(),
        object: last.object.clone(),
        before: last.outcome,
    });
    let reasons = refused(&mut session, label(Outcome::Slip));
    assert!(reasons[0].contains("was labelled stable"), "{reasons:?}");
    // The newest grasp is another one.
    play(&mut session, &mut store, Command::Grasp, &good());
    let seen = Seen {
        grasp: Some(last.id),
        ..Seen::default()
    };
    let label = Command::Label(Outcome::Slip);
    let reasons = refused(&mut session, remote(label, seen));
    assert!(reasons[0].contains("was saved"), "{reasons:?}");
}

#[test]
fn revision_follows_changes_and_refusals_of_triggers_only() {
    let (mut session, mut store) = (session().with_revision(100), Store::default());
    assert_eq!(revision(&session), 100);
    // Nothing to undo: nothing changed.
    handle(&mut session, Command::Undo, &good());
    assert_eq!(revision(&session), 100);
    play(&mut session, &mut store, Command::Trigger, &good());
    assert_eq!(revision(&session), 101);
    // An override would repeat this trigger, and no other.
    let no_contact = Conditions {
        skew_ms: 1e6,
        ..good()
    };
    handle(&mut session, Command::Trigger, &no_contact);
    assert_eq!((revision(&session), session.is_refused()), (102, true));
    handle(&mut session, Command::Redo, &good());
    assert_eq!((revision(&session), session.is_refused()), (103, false));
    let name = Command::Object("cup".parse().unwrap());
    handle(&mut session, name, &good());
    assert_eq!(revision(&session), 104);
}

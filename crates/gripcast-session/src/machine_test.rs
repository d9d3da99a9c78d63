//! Tests the session with a dataset in memory. One file, because all tests share that dataset.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;
use gripcast_base::files::ObjectName;
use gripcast_dataset::{GraspId, NameChange, Outcome};
use gripcast_imaging::{GelChange, GelProblem, Role};

/// A dataset in memory that refuses the same requests as a real one.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Store {
    next: u32,
    pending: BTreeMap<String, ()>,
    grasps: BTreeMap<String, (ObjectName, Outcome)>,
    trashed_pending: BTreeMap<String, ()>,
    trashed_grasps: BTreeMap<String, (ObjectName, Outcome)>,
    /// Undone grasp → pending frame reopened by the undo.
    reopened: BTreeMap<String, String>,
}

impl Store {
    fn new_id(&mut self) -> GraspId {
        self.next += 1;
        GraspId::parse(&format!("2026-11-20T10-15-03Z-{:04x}", self.next)).unwrap()
    }

    fn frame(id: GraspId) -> PendingFrame {
        PendingFrame {
            id,
            captured_at: "2026-11-20T10:15:03Z".into(),
            trigger_time_ns: 1,
            controls: BTreeMap::new(),
            external: None,
        }
    }

    fn grasp(&self, id: GraspId) -> StoreReply {
        let (object, outcome) = self.grasps[id.as_str()].clone();
        StoreReply::Grasp(last_grasp(id, object, outcome))
    }

    fn execute(&mut self, request: StoreRequest) -> StoreReply {
        match request {
            StoreRequest::SaveInitial { .. } => {
                let id = self.new_id();
                self.pending.insert(id.to_string(), ());
                StoreReply::Initial(Self::frame(id))
            }
            StoreRequest::SaveGrasp {
                initial, labels, ..
            } => {
                self.pending
                    .remove(initial.as_str())
                    .expect("pending initial");
                self.grasps
                    .insert(initial.to_string(), (labels.object, Outcome::Unlabelled));
                self.grasp(initial)
            }
            StoreRequest::SetOutcome { id, outcome } => {
                let Some(grasp) = self.grasps.get_mut(id.as_str()) else {
                    return Self::missing(&id);
                };
                let before = std::mem::replace(&mut grasp.1, outcome);
                StoreReply::Labelled {
                    object: grasp.0.clone(),
                    before,
                    id,
                }
            }
            StoreRequest::SetNames { id, names } => {
                let Some(grasp) = self.grasps.get_mut(id.as_str()) else {
                    return Self::missing(&id);
                };
                let new = names.object.unwrap_or_else(|| grasp.0.clone());
                let before = std::mem::replace(&mut grasp.0, new);
                let (object, outcome) = grasp.clone();
                StoreReply::Renamed {
                    before: NameChange {
                        object: (before != object).then_some(before),
                        ..NameChange::default()
                    },
                    grasp: last_grasp(id, object, outcome),
                }
            }
            StoreRequest::TrashGrasp { id } => {
                let Some((object, outcome)) = self.grasps.remove(id.as_str()) else {
                    return Self::missing(&id);
                };
                self.trashed_grasps
                    .insert(id.to_string(), (object.clone(), outcome));
                StoreReply::Trashed(last_grasp(id, object, outcome))
            }
            StoreRequest::RestoreGrasp { id } => {
                let reopened = self.reopened.get(id.as_str());
                if reopened.is_some_and(|pending| self.pending.contains_key(pending)) {
                    let message = "its initial frame is pending again".into();
                    return StoreReply::Failed { message };
                }
                let Some(grasp) = self.trashed_grasps.remove(id.as_str()) else {
                    return Self::missing(&id);
                };
                self.grasps.insert(id.to_string(), grasp);
                self.grasp(id)
            }
            StoreRequest::DiscardInitial { id } => {
                self.pending
                    .remove(id.as_str())
                    .expect("initial to discard");
                self.trashed_pending.insert(id.to_string(), ());
                StoreReply::Done
            }
            StoreRequest::RestoreInitial { id } => {
                self.trashed_pending
                    .remove(id.as_str())
                    .expect("initial in trash");
                self.pending.insert(id.to_string(), ());
                StoreReply::Initial(Self::frame(id))
            }
            StoreRequest::UndoGrasp { id } => {
                let grasp = self.grasps.remove(id.as_str()).expect("grasp to undo");
                self.trashed_grasps.insert(id.to_string(), grasp);
                let undone = id.to_string();
                let id = self.new_id();
                self.reopened.insert(undone, id.to_string());
                self.pending.insert(id.to_string(), ());
                StoreReply::Initial(Self::frame(id))
            }
            StoreRequest::RedoGrasp { id, reopened } => {
                let reopened = reopened.expect("reopened initial");
                self.pending
                    .remove(reopened.as_str())
                    .expect("reopened is pending");
                let grasp = self
                    .trashed_grasps
                    .remove(id.as_str())
                    .expect("grasp in trash");
                self.grasps.insert(id.to_string(), grasp);
                self.grasp(id)
            }
        }
    }

    fn missing(id: &GraspId) -> StoreReply {
        StoreReply::Failed {
            message: format!("grasp {id} not found"),
        }
    }

    /// Selects the id of a grasp, also in the trash, by number.
    fn any_id(&self, number: usize) -> GraspId {
        let all: Vec<&String> = self
            .grasps
            .keys()
            .chain(self.trashed_grasps.keys())
            .collect();
        let id = all.get(number % all.len().max(1));
        GraspId::parse(id.map_or("missing", |id| id.as_str())).unwrap()
    }

    fn count(&self, outcome: Outcome) -> usize {
        self.grasps.values().filter(|g| g.1 == outcome).count()
    }
}

fn last_grasp(id: GraspId, object: ObjectName, outcome: Outcome) -> LastGrasp {
    LastGrasp {
        id,
        object,
        outcome,
        predicted: None,
    }
}

/// Change of a gel that holds an object.
const HELD: GelChange = GelChange {
    contact_fraction: 0.2,
    illumination_levels: 1.0,
    is_other_gel: false,
    view_problem: None,
};

fn change(contact_fraction: f64, illumination_levels: f64) -> GelChange {
    GelChange {
        contact_fraction,
        illumination_levels,
        is_other_gel: false,
        view_problem: None,
    }
}

/// Conditions of a gripper that holds an object; [`handle`] opens it for an initial frame.
pub(crate) fn good() -> Conditions {
    let camera = |role| CameraCondition {
        role,
        age_ms: Some(20.0),
        frame_time_ns: 2,
        fault: None,
        controls: BTreeMap::new(),
        change: Some(HELD),
        gel_problems: Vec::new(),
    };
    Conditions {
        now_ns: 0,
        cameras: vec![camera(Role::Left), camera(Role::Right)],
        skew_ms: 5.0,
        disk_free_bytes: Some(10_000_000_000),
    }
}

pub(crate) fn session() -> Session {
    let labels = Labels {
        object: "mug".parse().unwrap(),
        ..Labels::default()
    };
    Session::new(GuardLimits::default(), labels, OutcomeCounts::new(), None)
}

/// Handles a command like the engine: only triggers get camera conditions.
pub(crate) fn handle(session: &mut Session, command: Command, now: &Conditions) -> Vec<Effect> {
    let mut now = now.clone();
    let is_initial = command == Command::Initial
        || (command == Command::Trigger && session.step() == Step::Initial);
    let held = now.cameras.iter_mut().filter(|c| c.change == Some(HELD));
    held.filter(|_| is_initial)
        .for_each(|c| c.change = Some(change(0.0, 0.1)));
    let now = session.is_trigger(&command).then_some(&now);
    let request = Request::new(7, command, CommandSource::Keyboard);
    session.handle(request, now)
}

/// Result in the effects.
pub(crate) fn result(effects: &[Effect]) -> &CommandResult {
    let Some(Effect::Result { id: 7, result }) = effects.last() else {
        panic!("{effects:?}");
    };
    result
}

fn is_refused(effects: &[Effect]) -> bool {
    effects[0] == Effect::Tone(Tone::Refused)
        && matches!(result(effects), CommandResult::Refused { .. })
}

/// Handles a command and executes its effects.
pub(crate) fn play(
    session: &mut Session,
    store: &mut Store,
    command: Command,
    now: &Conditions,
) -> Vec<Tone> {
    let mut effects = handle(session, command, now);
    let mut tones = Vec::new();
    let mut results = 0;
    while !effects.is_empty() {
        let mut next = Vec::new();
        for effect in effects {
            match effect {
                Effect::Store(request) => {
                    let reply = store.execute(request);
                    next.extend(session.completed(reply));
                }
                Effect::Tone(tone) => tones.push(tone),
                Effect::Result { id, .. } => {
                    assert_eq!(id, 7);
                    results += 1;
                }
                Effect::UseInitial(_) | Effect::Quit => {}
            }
        }
        effects = next;
    }
    assert_eq!(results, 1, "a command has one result");
    assert!(!session.is_storing(), "a request has no reply");
    tones
}

#[test]
fn cycle_ends_with_a_label() {
    let (mut session, mut store) = (session(), Store::default());
    assert_eq!(session.step(), Step::Initial);
    let tones = play(&mut session, &mut store, Command::Trigger, &good());
    assert_eq!(
        (tones, session.step()),
        (vec![Tone::InitialSaved], Step::Grasp)
    );
    let tones = play(&mut session, &mut store, Command::Trigger, &good());
    assert_eq!(
        (tones, session.step()),
        (vec![Tone::GraspSaved], Step::Label)
    );
    let stable = Command::Label(Outcome::Stable);
    let tones = play(&mut session, &mut store, stable, &good());
    assert_eq!((tones, session.step()), (vec![Tone::Stable], Step::Initial));
    let counts = session.view(0).counts;
    assert_eq!((counts.stable, counts.object_stable), (1, 1));
}

#[test]
fn guards_refuse_and_override_is_recorded() {
    type Change = fn(&mut Conditions);
    let cases: [(Guard, Change); 9] = [
        (Guard::StaleFrame, |c| c.cameras[0].age_ms = Some(500.0)),
        (Guard::Skew, |c| c.skew_ms = 90.0),
        (Guard::DiskLow, |c| c.disk_free_bytes = Some(5)),
        (Guard::NoContact, |c| {
            for camera in &mut c.cameras {
                camera.change = Some(change(0.0, 0.1));
            }
        }),
        (Guard::IlluminationChanged, |c| {
            for camera in &mut c.cameras {
                camera.change = Some(change(0.001, 12.0));
            }
        }),
        (Guard::OneSidedContact, |c| {
            c.cameras[0].change = Some(change(0.001, 12.0));
        }),
        (Guard::OneSidedContact, |c| {
            c.cameras[1].change = Some(change(0.0, 0.1));
        }),
        (Guard::OtherGel, |c| {
            let other = GelChange {
                is_other_gel: true,
                ..change(0.4, 30.0)
            };
            c.cameras[1].change = Some(other);
        }),
        (Guard::GelImage, |c| {
            c.cameras[0].gel_problems = vec![GelProblem::Flickering];
        }),
    ];
    for (guard, change) in cases {
        let (mut session, mut store) = (session(), Store::default());
        play(&mut session, &mut store, Command::Initial, &good());
        let mut bad = good();
        change(&mut bad);
        assert!(is_refused(&handle(&mut session, Command::Grasp, &bad)));
        assert!(session.view(0).refusal.unwrap().can_override, "{guard:?}");
        let effects = handle(&mut session, Command::Override, &bad);
        let [Effect::Store(StoreRequest::SaveGrasp { overridden, .. })] = &effects[..] else {
            panic!("{guard:?}: {effects:?}");
        };
        assert_eq!(overridden.len(), 1);
        assert_eq!(overridden[0].guard, guard.name());
        assert_eq!(overridden[0].stage, "grasp");
    }
}

#[test]
fn gel_problems_refuse_the_initial_frame() {
    use GelProblem::{Black, Drifting, Flickering, LampDead, Noisy, Saturated, Swapped};
    for problem in [
        Black, LampDead, Saturated, Noisy, Flickering, Drifting, Swapped,
    ] {
        let mut bad = good();
        bad.cameras[1].gel_problems = vec![problem];
        let (mut session, mut store) = (session(), Store::default());
        assert!(is_refused(&handle(&mut session, Command::Initial, &bad)));
        let refusal = session.view(0).refusal.unwrap();
        assert!(refusal.can_override && refusal.reasons[0].starts_with("right: "));
        play(&mut session, &mut store, Command::Override, &bad);
        assert_eq!(session.step(), Step::Grasp);
        // A closing gripper changes the light.
        let refused = is_refused(&handle(&mut session, Command::Grasp, &bad));
        assert_eq!(refused, problem != Drifting, "{problem:?}");
    }
    let mut marked = good();
    marked.cameras[1].gel_problems = vec![GelProblem::Marked];
    let mut session = session();
    assert!(!is_refused(&handle(
        &mut session,
        Command::Initial,
        &marked
    )));
}

#[test]
fn one_sided_contact_names_the_gel() {
    let (mut session, mut store) = (session(), Store::default());
    play(&mut session, &mut store, Command::Initial, &good());
    let mut now = good();
    now.cameras[1].change = Some(change(0.001, 0.1));
    handle(&mut session, Command::Grasp, &now);
    let reasons = session.view(0).refusal.unwrap().reasons;
    assert!(
        reasons[0].starts_with("only the left gel is in contact"),
        "{reasons:?}"
    );
}

#[test]
fn initial_frame_of_a_closed_gripper_is_refused() {
    let closed = |left, right| {
        let mut now = good();
        now.cameras[0].change = left;
        now.cameras[1].change = right;
        now
    };
    let open = Some(change(0.001, 0.1));
    for now in [
        closed(Some(change(0.3, 1.0)), Some(change(0.25, 1.0))),
        closed(Some(change(0.3, 1.0)), open),
        closed(None, Some(change(0.3, 1.0))),
    ] {
        let (mut session, mut store) = (session(), Store::default());
        assert!(is_refused(&handle(&mut session, Command::Trigger, &now)));
        let refusal = session.view(0).refusal.unwrap();
        assert!(refusal.can_override);
        assert!(
            refusal.reasons[0].contains("still closed"),
            "{:?}",
            refusal.reasons
        );
        play(&mut session, &mut store, Command::Override, &now);
        assert_eq!(session.step(), Step::Grasp);
        // Retaking it with closed fingers is refused as well.
        assert!(is_refused(&handle(&mut session, Command::Initial, &now)));
    }
    let other = GelChange {
        is_other_gel: true,
        ..change(0.4, 30.0)
    };
    // Nothing to compare with, a new gel and other light are no contact.
    for change in [None, open, Some(other), Some(change(0.001, 30.0))] {
        let now = closed(change, change);
        let effects = handle(&mut session(), Command::Trigger, &now);
        assert!(matches!(effects[..], [Effect::Store(_)]), "{effects:?}");
    }
    let limits = GuardLimits {
        min_contact_fraction: 0.0,
        ..GuardLimits::default()
    };
    let now = closed(Some(change(0.3, 1.0)), Some(change(0.3, 1.0)));
    assert!(guard::check_open(&limits, &now).is_empty());
}

#[test]
fn only_triggers_need_camera_conditions() {
    let (mut session, mut store) = (session(), Store::default());
    let trigger = |session: &Session, text: &str| session.is_trigger(&text.parse().unwrap());
    for text in ["undo", "redo", "object cup", "stable", "override", "quit"] {
        assert!(!trigger(&session, text), "{text}");
    }
    assert!(!trigger(&session, "relabel 2026-11-20T10-15-03Z-7f3a slip"));
    for text in ["trigger", "initial", "grasp"] {
        assert!(trigger(&session, text), "{text}");
    }
    handle(&mut session, Command::Grasp, &good());
    assert!(!trigger(&session, "override"), "cannot be overridden");
    play(&mut session, &mut store, Command::Trigger, &good());
    let mut bad = good();
    bad.skew_ms = 90.0;
    handle(&mut session, Command::Grasp, &bad);
    assert!(trigger(&session, "override"));
    play(&mut session, &mut store, Command::Override, &bad);
    assert_eq!(session.step(), Step::Label);
    assert!(!trigger(&session, "trigger"), "a label is pending");
}

#[test]
fn trigger_without_camera_conditions_is_refused() {
    let mut session = session();
    let request = Request::new(7, Command::Initial, CommandSource::Script);
    assert!(is_refused(&session.handle(request, None)));
    assert!(!session.is_storing());
}

#[test]
fn changed_exposure_is_refused_with_both_values() {
    let mut initial = Store::frame(GraspId::parse("x").unwrap());
    let controls = |exposure| BTreeMap::from([("exposure_time_absolute".to_owned(), exposure)]);
    initial.controls.insert(Role::Left, controls(180));
    let labels = Labels::default();
    let mut session = Session::new(
        GuardLimits::default(),
        labels,
        OutcomeCounts::new(),
        Some(initial),
    );
    let mut now = good();
    now.cameras[0].controls = controls(220);
    handle(&mut session, Command::Grasp, &now);
    let reasons = session.view(0).refusal.unwrap().reasons;
    assert!(
        reasons[0].contains("exposure_time_absolute 180 → 220"),
        "{reasons:?}"
    );
}

#[test]
fn missing_gel_or_initial_cannot_be_overridden() {
    let (mut session, mut store) = (session(), Store::default());
    assert!(is_refused(&handle(&mut session, Command::Grasp, &good())));
    assert!(is_refused(&handle(
        &mut session,
        Command::Override,
        &good()
    )));
    play(&mut session, &mut store, Command::Initial, &good());
    let mut bad = good();
    bad.cameras[1].age_ms = None;
    bad.cameras[1].fault = Some("unplugged".into());
    handle(&mut session, Command::Grasp, &bad);
    assert!(!session.view(0).refusal.unwrap().can_override);
    handle(&mut session, Command::Override, &bad);
    assert_eq!(store.grasps.len(), 0);
    assert_eq!(session.step(), Step::Grasp);
}

/// A screen shows the first reason big; overriding the others would not help.
#[test]
fn reason_that_cannot_be_overridden_comes_first() {
    let (mut session, mut store) = (session(), Store::default());
    play(&mut session, &mut store, Command::Initial, &good());
    let mut bad = good();
    bad.skew_ms = 1e6;
    bad.cameras[0].age_ms = Some(1e6);
    bad.cameras[1].age_ms = None;
    bad.cameras[1].fault = Some("unplugged".into());
    handle(&mut session, Command::Grasp, &bad);
    let reasons = session.view(0).refusal.unwrap().reasons;
    let is_missing = reasons[0].contains("unplugged");
    assert!(is_missing && reasons.len() >= 3, "{reasons:?}");
}

#[test]
fn initial_frame_is_not_saved_as_grasp() {
    let (mut session, mut store) = (session(), Store::default());
    let mut now = good();
    now.now_ns = 1_000;
    for camera in &mut now.cameras {
        camera.frame_time_ns = 990;
    }
    play(&mut session, &mut store, Command::Initial, &now);
    now.now_ns = 1_010;
    handle(&mut session, Command::Grasp, &now);
    let refusal = session.view(0).refusal.unwrap();
    assert!(!refusal.can_override && refusal.reasons[0].contains("since the last capture"));
    for camera in &mut now.cameras {
        camera.frame_time_ns = 1_005;
    }
    play(&mut session, &mut store, Command::Grasp, &now);
    assert_eq!(session.step(), Step::Label);
}

#[test]
fn unknown_contact_is_refused() {
    let (mut session, mut store) = (session(), Store::default());
    play(&mut session, &mut store, Command::Initial, &good());
    let mut now = good();
    for camera in &mut now.cameras {
        camera.change = None;
    }
    handle(&mut session, Command::Grasp, &now);
    assert!(session.view(0).refusal.unwrap().reasons[0].contains("contact unknown"));
}

#[test]
fn failed_save_keeps_the_step_with_an_error() {
    let (mut session, mut store) = (session(), Store::default());
    play(&mut session, &mut store, Command::Trigger, &good());
    handle(&mut session, Command::Trigger, &good());
    let message = "no storage space".to_owned();
    let effects = session.completed(StoreReply::Failed { message });
    assert!(effects.contains(&Effect::Tone(Tone::Fault)));
    let CommandResult::Failed { error } = result(&effects) else {
        panic!("{effects:?}");
    };
    assert!(error.contains("NOT saved") && error.contains("no storage space"));
    assert_eq!(session.step(), Step::Grasp);
    assert!(
        session
            .view(0)
            .message
            .unwrap()
            .text
            .contains("no storage space")
    );
    play(&mut session, &mut store, Command::Trigger, &good());
    assert_eq!(session.step(), Step::Label);
}

#[test]
fn pending_initial_frame_is_resumed() {
    let frame = Store::frame(GraspId::parse("2026-11-20T10-15-03Z-00ff").unwrap());
    let session = Session::new(
        GuardLimits::default(),
        Labels::default(),
        OutcomeCounts::new(),
        Some(frame),
    );
    assert_eq!(session.step(), Step::Grasp);
    assert!(session.view(0).message.unwrap().text.contains("resuming"));
}

/// A command, with the number of the grasp that it refers to.
fn any_command() -> impl Strategy<Value = (Command, usize)> {
    let missing = || GraspId::parse("missing").unwrap();
    let command = prop_oneof![
        4 => Just(Command::Trigger),
        2 => Just(Command::Initial),
        2 => Just(Command::Grasp),
        2 => Just(Command::Label(Outcome::Stable)),
        2 => Just(Command::Label(Outcome::Slip)),
        1 => Just(Command::Label(Outcome::Unlabelled)),
        5 => Just(Command::Undo),
        4 => Just(Command::Redo),
        1 => Just(Command::Override),
        1 => Just(Command::Object("cup".parse().unwrap())),
        2 => Just(Command::Relabel(missing(), Outcome::Slip)),
        2 => Just(Command::Edit(missing(), NameChange::parse("object cup").unwrap())),
        2 => Just(Command::EditLast(NameChange::parse("object jar").unwrap())),
        3 => Just(Command::Trash(missing())),
        3 => Just(Command::Restore(missing())),
    ];
    (command, 0..6_usize)
}

/// Replaces the number of the grasp by its id.
fn with_id((command, number): (Command, usize), store: &Store) -> Command {
    match command {
        Command::Relabel(_, outcome) => Command::Relabel(store.any_id(number), outcome),
        Command::Edit(_, names) => Command::Edit(store.any_id(number), names),
        Command::Trash(_) => Command::Trash(store.any_id(number)),
        Command::Restore(_) => Command::Restore(store.any_id(number)),
        other => other,
    }
}

#[test]
fn trashed_grasp_is_not_the_last_until_restored() {
    let (mut session, mut store) = (session(), Store::default());
    for command in [Command::Trigger, Command::Trigger] {
        play(&mut session, &mut store, command, &good());
    }
    let id = session.view(0).last.unwrap().id;
    play(
        &mut session,
        &mut store,
        Command::Trash(id.clone()),
        &good(),
    );
    assert_eq!(session.step(), Step::Initial);
    assert_eq!(session.view(0).counts.unlabelled, 0);
    play(&mut session, &mut store, Command::Undo, &good());
    assert_eq!(session.view(0).last.unwrap().id, id);
    assert_eq!(session.step(), Step::Label);
    play(&mut session, &mut store, Command::Undo, &good());
    let tones = play(&mut session, &mut store, Command::Restore(id), &good());
    assert_eq!(tones, [Tone::Fault], "its initial frame is pending again");
    assert_eq!(session.step(), Step::Grasp);
}

#[test]
fn object_of_any_grasp_is_corrected_and_undone() {
    let (mut session, mut store) = (session(), Store::default());
    let stable = Command::Label(Outcome::Stable);
    for command in [Command::Trigger, Command::Trigger, stable] {
        play(&mut session, &mut store, command, &good());
    }
    let last = session.view(0).last.unwrap();
    let edit = |name: &str| Command::Edit(last.id.clone(), NameChange::parse(name).unwrap());
    play(&mut session, &mut store, edit("object jar"), &good());
    let view = session.view(0);
    assert_eq!(view.last.as_ref().unwrap().object, "jar");
    assert_eq!((view.counts.stable, view.counts.object_stable), (1, 0));
    assert_eq!(view.undo.as_deref(), Some("object jar of 0001"));
    // The same name again is no step.
    play(&mut session, &mut store, edit("object jar"), &good());
    play(&mut session, &mut store, Command::Undo, &good());
    let view = session.view(0);
    assert_eq!(view.last.unwrap().object, last.object);
    assert_eq!(view.counts.object_stable, 1);
    play(&mut session, &mut store, Command::Redo, &good());
    assert_eq!(session.view(0).last.unwrap().object, "jar");
    let cup = Command::EditLast(NameChange::parse("object cup").unwrap());
    play(&mut session, &mut store, cup, &good());
    assert_eq!(session.view(0).last.unwrap().object, "cup");
    let missing = GraspId::parse("missing").unwrap();
    let edit = Command::Edit(missing, NameChange::parse("scene lab").unwrap());
    let tones = play(&mut session, &mut store, edit, &good());
    assert_eq!(tones, [Tone::Fault]);
}

proptest! {
    /// For any commands, session and dataset agree, every request is valid, and undoing everything
    /// leaves only trash.
    #[test]
    fn session_and_dataset_always_agree(
        commands in proptest::collection::vec((any_command(), any::<bool>()), 0..60)
    ) {
        let (mut session, mut store) = (session(), Store::default());
        for (command, contact) in commands {
            let mut now = good();
            if !contact {
                for camera in &mut now.cameras {
                    camera.change = Some(change(0.0, 0.1));
                }
            }
            let command = with_id(command, &store);
            play(&mut session, &mut store, command, &now);
            let view = session.view(0);
            prop_assert_eq!(view.counts.stable, store.count(Outcome::Stable));
            prop_assert_eq!(view.counts.slip, store.count(Outcome::Slip));
            prop_assert_eq!(view.counts.unlabelled, store.count(Outcome::Unlabelled));
            prop_assert_eq!(store.pending.len(), usize::from(view.step == Step::Grasp));
            if let Some(last) = &view.last {
                let (object, outcome) = &store.grasps[&last.id.to_string()];
                prop_assert_eq!((object, outcome), (&last.object, &last.outcome));
            }
            let of_object = |outcome| {
                let object = &view.object;
                store.grasps.values().filter(|g| (&g.0, g.1) == (object, outcome)).count()
            };
            prop_assert_eq!(view.counts.object_stable, of_object(Outcome::Stable));
            prop_assert_eq!(view.counts.object_slip, of_object(Outcome::Slip));
        }
        while session.view(0).undo.is_some() {
            play(&mut session, &mut store, Command::Undo, &good());
        }
        prop_assert_eq!((store.pending.len(), store.grasps.len()), (0, 0));
        while session.view(0).redo.is_some() {
            play(&mut session, &mut store, Command::Redo, &good());
        }
        let view = session.view(0);
        prop_assert_eq!(view.counts.stable, store.count(Outcome::Stable));
    }
}

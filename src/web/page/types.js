/**
 * Types of the server's messages, with the names and units of the API.
 *
 * @typedef {"left"|"right"|"rgb"|"depth"|"external"} Role
 * @typedef {"stable"|"slip"|"unlabelled"} Outcome
 * @typedef {"initial"|"grasp"|"label"} Step
 * @typedef {"initial_saved"|"grasp_saved"|"stable"|"slip"|"undone"|"refused"|"fault"} Tone
 *
 * @typedef {object} Predicted prediction of a grasp before the lift
 * @property {number} p_stable
 * @property {number} threshold
 * @property {number} [ood_score] OOD score; above 1: unlike the training images
 * @property {string} [unsure_reason] why the images cannot tell
 * @property {{p_stable: number, base_rate: number, labels: number}} [adapted] at the base rate of the rig's labels
 * @property {{error_rate: number, stable: boolean, slip: boolean}} [set] outcomes that are open
 * @property {string} model
 * @property {number} latency_ms
 * @property {number} engine_ms
 *
 * @typedef {object} LastGrasp
 * @property {string} id
 * @property {string} object
 * @property {Outcome} outcome
 * @property {Predicted|null} predicted
 *
 * @typedef {object} Counts
 * @property {number} stable
 * @property {number} slip
 * @property {number} unlabelled
 * @property {number} object_stable
 * @property {number} object_slip
 *
 * @typedef {object} Refusal
 * @property {string} stage
 * @property {string[]} reasons
 * @property {boolean} can_override
 *
 * @typedef {object} Session
 * @property {number} revision number of the state
 * @property {Step} step
 * @property {string} object
 * @property {string} scene
 * @property {string} operator
 * @property {string|null} initial_at
 * @property {number|null} initial_age_s
 * @property {Counts} counts
 * @property {LastGrasp|null} last
 * @property {string|null} undo
 * @property {string|null} redo
 * @property {{level: "info"|"warning"|"error", text: string}|null} message
 * @property {Refusal|null} refusal
 * @property {boolean} saving
 *
 * @typedef {object} Camera
 * @property {Role} role
 * @property {string} product
 * @property {string} serial
 * @property {string} port
 * @property {"opening"|"live"|"damaged"|"silent"|"frozen"|"no_valid_depth"|"unplugged"|"unavailable"|"ended"} state
 * @property {number} [for_s] seconds since it is silent or frozen, or has no depth
 * @property {number} [fraction] damaged fraction of its newest frames
 * @property {string} [reason] what the decoder says, or why it cannot be opened
 * @property {number} measured_fps
 * @property {number} nominal_fps
 * @property {number|null} frame_age_ms
 * @property {number} received
 * @property {number} sequence_gaps
 * @property {number} damaged
 * @property {number} late
 * @property {number} reconnects
 * @property {{ok: boolean, text: string}|null} markers
 *
 * @typedef {Predicted & {verdict: "stable"|"slip"|"unsure", heuristic: boolean, frame_age_ms: number}} Prediction
 *
 * @typedef {object} Shear of a gel since the initial frame; axes of its image, x right, y down
 * @property {{confidence: number, mean_displacement_mm: [number, number], slip_ratio: number|null}|null} summary
 * @property {string[]} messages
 *
 * @typedef {object} Force on a gel since the initial frame
 * @property {number} normal_n
 * @property {number} normal_std_n
 * @property {[number, number]|null} shear_n
 * @property {number|null} shear_std_n
 * @property {boolean} is_calibrated whether known weights calibrated the sensor
 *
 * @typedef {object} Gel
 * @property {string[]} problems
 * @property {string[]} messages a sentence with remedy for each problem
 * @property {"unchanged"|"contact"|"illumination"|"other_gel"|null} change
 *
 * @typedef {object} Seen what the operator saw; a command is refused where it differs
 * @property {number} [revision]
 * @property {Outcome} [outcome] of the newest grasp
 * @property {string} [undo]
 * @property {string} [redo]
 *
 * @typedef {object} State
 * @property {number} monotonic_ms clock of the server
 * @property {string} dataset
 * @property {string} rig
 * @property {string} clock
 * @property {number|null} disk_free_bytes
 * @property {number|null} grasps_left grasps that still fit on the disk
 * @property {number} target_per_object labelled grasps wanted per object; 0: no target
 * @property {{subject: string, level: "info"|"warning"|"error", text: string}[]} [start_report]
 * @property {Session} session
 * @property {Camera[]} cameras
 * @property {Prediction|null} prediction
 * @property {string|null} no_prediction_reason
 * @property {{p_stable: number, p_before: number, is_stable: boolean, is_slipping: boolean}|null} [lift]
 * @property {{left?: number, right?: number}} contact
 * @property {{left?: Gel, right?: Gel}} [gels]
 * @property {{left?: Shear, right?: Shear}} [shear]
 * @property {{left?: Force, right?: Force}} [force]
 *
 * @typedef {object} CommandResponse
 * @property {"accepted"|"refused"|"failed"} result
 * @property {string[]} [reasons] of a refusal
 * @property {boolean} [can_override]
 * @property {boolean} [stale] the command no longer fitted
 * @property {string} [error] of a failure
 * @property {State} state
 *
 * @typedef {object} ObjectCounts
 * @property {string} object
 * @property {number} stable
 * @property {number} slip
 * @property {number} unlabelled
 *
 * @typedef {object} GraspSummary
 * @property {string} id
 * @property {string} object
 * @property {string} scene
 * @property {string} operator
 * @property {Outcome} outcome
 * @property {string|null} labelled_at
 * @property {string} captured_at
 * @property {Predicted|null} prediction
 * @property {boolean|null} agrees
 * @property {Role[]} roles
 *
 * @typedef {{type: "state", state: State} | {type: "tone", tone: Tone}
 *   | {type: "stored", stored: object} | {type: "shutdown"}} Event
 */
export {};

//! The simulator against other implementations and closed forms.

mod ipctk;

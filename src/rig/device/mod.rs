//! Discovery, identity and access rights of USB cameras.

//! Many runs of networks that differ in a few values: each variant is a row of one table.
//!
//! Input: a [`file::SweepFile`], which lists the varied values. Output: a [`table::Table`] with a
//! row for each variant. It does not depend on the number of threads or on interruptions.
//! [`variants`] numbers the variants and lists their changes, [`cache`] caches shared values,
//! [`row`] runs one variant, [`identity`] finds the files of a sweep, [`work`] runs all on several
//! threads, [`table`] is the result.
//! `report::sweep` plots two columns. A row equals the output of the single commands with the same
//! values. Errors: `sweep.*`; a variant that cannot be run has a row with the reason.

pub mod cache;
pub mod file;
pub mod identity;
pub mod row;
pub mod table;
pub mod variants;
pub mod work;

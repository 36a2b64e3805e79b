//! Many runs of networks that differ in a few values: each variant a row of one table.
//!
//! Input: a [`file::SweepFile`], which says what varies. Output: a [`table::Table`] with a row for
//! each variant, the same for any number of threads and however often the work was ended on its
//! way. [`variants`] counts the variants and says what each changes, [`made`] stores what they
//! share, [`row`] runs any, [`work`] runs all on several threads, [`table`] is the result,
//! `report::sweep` draws two of its columns. Each row holds what the single commands print under
//! the same values. Errors: `sweep.*`; a variant that cannot be run has a row that says why.

pub mod file;
pub mod made;
pub mod row;
pub mod table;
pub mod variants;
pub mod work;

//! From a network to a program, one stage a line.

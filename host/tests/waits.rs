//! What a person at a terminal sees while a program works for longer than a second.

use crate::terminal::AtTerminal;

#[test]
fn long_work_says_what_it_is_and_how_long_it_takes_as_a_rule() {
    let words = ["--robot", "kr16_2", "--target", "2.5,0,0.6"];
    for verb in [&["throw"][..], &["plan", "throw"]] {
        let mut program = AtTerminal::run(&[verb, &words].concat());
        program.sees("looking for a throw, as a rule 10 to 30 s");
        program.kill();
    }
}

//! Compile-fail tests: code outside the arming module cannot construct, copy, inspect or reuse a
//! [`flight_core::MotorPermit`].

#[test]
#[cfg_attr(miri, ignore = "runs the compiler")]
fn misuse_of_a_permit_does_not_compile() {
    trybuild::TestCases::new().compile_fail("tests/permit_misuse/*.rs");
}

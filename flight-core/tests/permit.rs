//! Nobody but the arming table can make a [`flight_core::MotorPermit`], keep one, or use one twice: what tries
//! does not compile.

#[test]
#[cfg_attr(miri, ignore = "runs the compiler")]
fn there_is_no_other_way_to_a_permit() {
    trybuild::TestCases::new().compile_fail("tests/no_other_permit/*.rs");
}

//! Harness of the recorded-frame tests.

// clang-format off
// Every line that the pilot can get as STATUSTEXT, once, without the word "Echowing" with which
// all begin.
//
// ECHOWING_NOTICE(identifier, severity, "text")

// One for each ResetCause, in its order.
ECHOWING_NOTICE(kStarted, ECHOWING_INFO, ": started")
ECHOWING_NOTICE(kStartedAtPowerOn, ECHOWING_INFO, ": started, power on")
ECHOWING_NOTICE(kStartedAfterBrownOut, ECHOWING_WARNING, ": started, supply was too low")
ECHOWING_NOTICE(kStartedByPin, ECHOWING_INFO, ": started, reset pin")
ECHOWING_NOTICE(kStartedByWatchdog, ECHOWING_WARNING, ": started, watchdog")
ECHOWING_NOTICE(kStartedByOrder, ECHOWING_INFO, ": started, by command")

ECHOWING_NOTICE(kSonarFault, ECHOWING_CRITICAL, ": sonar does not answer")
ECHOWING_NOTICE(kSonarBack, ECHOWING_INFO, ": sonar answers again")
ECHOWING_NOTICE(kAddressChanged, ECHOWING_INFO, ": sonar address changed")
ECHOWING_NOTICE(kParametersCorrupt, ECHOWING_WARNING, ": memory corrupt, defaults in use")
ECHOWING_NOTICE(kParametersStored, ECHOWING_INFO, ": parameters stored")
ECHOWING_NOTICE(kParametersNotStored, ECHOWING_WARNING, ": parameters NOT stored, memory fails")
ECHOWING_NOTICE(kParametersReset, ECHOWING_INFO, ": parameters set to defaults")
ECHOWING_NOTICE(kSystemLearned, ECHOWING_INFO, ": system id learned from the autopilot")
ECHOWING_NOTICE(kSeveralVehicles, ECHOWING_WARNING, ": several vehicles detected, set SYS_ID")
ECHOWING_NOTICE(kOnlyOtherVehicles, ECHOWING_WARNING, ": other vehicles detected, check SYS_ID")
ECHOWING_NOTICE(kNotInFlight, ECHOWING_WARNING, ": parameter not changed in flight")
ECHOWING_NOTICE(kTestSonarGood, ECHOWING_INFO, " test: sonar good")
ECHOWING_NOTICE(kTestSonarBad, ECHOWING_WARNING, " test: sonar gives no reading")
ECHOWING_NOTICE(kTestMemoryGood, ECHOWING_INFO, " test: memory good")
ECHOWING_NOTICE(kTestMemoryBad, ECHOWING_WARNING, " test: memory corrupt")
ECHOWING_NOTICE(kTestLinkLooped, ECHOWING_INFO, " test: autopilot port looped, good")
ECHOWING_NOTICE(kTestLinkOpen, ECHOWING_INFO, " test: autopilot port has no loop plug")
ECHOWING_NOTICE(kTestUsbLooped, ECHOWING_INFO, " test: USB port looped, good")
ECHOWING_NOTICE(kTestUsbOpen, ECHOWING_INFO, " test: USB port has no loop plug")
ECHOWING_NOTICE(kTestEnded, ECHOWING_INFO, " test: ended; did the servos sweep?")

// stm32duino's backup registers, as far as they are used.
#pragma once

#include <stdint.h>

#define LL_RTC_BKP_DR1 1u

void enableBackupDomain();
void setBackupRegister(uint32_t index, uint32_t value);
uint32_t getBackupRegister(uint32_t index);

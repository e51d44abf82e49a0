-DI2C_TIMEOUT_TICK=3
'-DError_Handler()=__builtin_trap()'
'-D_Error_Handler(text,line)=__builtin_trap()'
-DHAL_EXTI_MODULE_DISABLED

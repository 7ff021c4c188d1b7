/* The one function of Windows 10 that programs of Rust take from bcryptprimitives.dll, for versions of Wine before 8.8, which lack the library.
 * It is put into the folder of settings that tests use, and is part of no bundle. */
#include <windows.h>

BOOLEAN NTAPI SystemFunction036(PVOID bytes, ULONG length);

__declspec(dllexport) BOOL WINAPI ProcessPrng(PBYTE bytes, SIZE_T length)
{
    return SystemFunction036(bytes, (ULONG)length);
}

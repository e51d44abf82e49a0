/* An emulated STM32 board: its memory map, its power, and its time. */
#include <elf.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "stm32.h"

#define FLASH_BASE 0x08000000u
#define RAM_BASE 0x20000000u
#define PAINT 0xa5a5a5a5u /* fresh memory */

enum { /* RCC's CSR: why the program was started */
       PIN_RESET = 1u << 26,
       POWER_RESET = 1u << 27,
       SOFT_RESET = 1u << 28,
       WATCHDOG_RESET = 1u << 29,
       STARTING_RELOADS = 2, /* as the watchdog is set up, and as the first turn begins */
       PAGE = 4096,
};

/* Typical times from the data sheets: F103xB table 28, F411 table 44 (32 bits at a time), F446
 * table 48. The F1's own oscillators have 8 MHz and 40 kHz, the F4's 16 MHz and 32 kHz. */
static const chip_t kChips[] = {
    {.name = "stm32f411",
     .debug_id = 0x10006431,
     .flash_size = 512 << 10,
     .ram_size = 128 << 10,
     .slot_size = 128 << 10,
     .rom_base = 0x1fff0000,
     .rom_size = 0x7800,
     .info_base = 0x1fff0000,
     .unique_id = 0x1fff7a10,
     .rcc = 0x40023800,
     .flash = 0x40023c00,
     .gpio = 0x40020000,
     .gpio_ports = 8,
     .usart = {0x40011000, 0x40004400},
     .hsi_hz = 16000000,
     .lsi_hz = 32000,
     .erase_us = 1000000,
     .program_ns = 16000,
     .program_bytes = 4},
    {.name = "stm32f446",
     .debug_id = 0x10006421,
     .flash_size = 512 << 10,
     .ram_size = 128 << 10,
     .slot_size = 128 << 10,
     .rom_base = 0x1fff0000,
     .rom_size = 0x7800,
     .info_base = 0x1fff0000,
     .unique_id = 0x1fff7a10,
     .rcc = 0x40023800,
     .flash = 0x40023c00,
     .gpio = 0x40020000,
     .gpio_ports = 8,
     .usart = {0x40011000, 0x40004400},
     .hsi_hz = 16000000,
     .lsi_hz = 32000,
     .erase_us = 1000000,
     .program_ns = 16000,
     .program_bytes = 4},
    {.name = "stm32f103",
     .debug_id = 0x20036410,
     .is_f1 = 1,
     .flash_size = 64 << 10,
     .ram_size = 20 << 10,
     .slot_size = 1 << 10,
     .rom_base = 0x1ffff000,
     .rom_size = 0x7e0,
     .info_base = 0x1ffff000,
     .unique_id = 0x1ffff7e8,
     .rcc = 0x40021000,
     .flash = 0x40022000,
     .gpio = 0x40010800,
     .gpio_ports = 5,
     .usart = {0x40013800, 0x40004400},
     .hsi_hz = 8000000,
     .lsi_hz = 40000,
     .erase_us = 20000,
     .program_ns = 52500,
     .program_bytes = 2},
};

void board_complain(board_t* board, const char* format, ...) {
  if (board->fault[0]) return;
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(board->fault, sizeof board->fault, format, arguments);
  va_end(arguments);
  core_attend(board);
}

/* ---- the memory map */

static int within(uint32_t address, uint32_t base, uint32_t size) { return address - base < size; }

static uint32_t peripheral_read(board_t* board, uint32_t address) {
  const chip_t* chip = board->chip;
  if (!rcc_is_clocked(board, address)) return 0;
  if (within(address, chip->rcc, 0x100)) return rcc_read(board, address - chip->rcc);
  if (within(address, chip->flash, 0x100)) return flash_read(board, address - chip->flash);
  if (within(address, chip->gpio, chip->gpio_ports * 0x400))
    return gpio_read(board, (int)(address - chip->gpio) / 0x400, address & 0x3ff);
  for (int i = 0; i < UARTS; i++) {
    if (within(address, chip->usart[i], 0x20))
      return usart_read(board, i, address - chip->usart[i]);
  }
  if (within(address, 0x40000400, 0x80)) return timer_read(board, address - 0x40000400);
  if (within(address, 0x40005400, 0x40)) return i2c_read(board, address - 0x40005400);
  if (within(address, 0x40003000, 0x10)) return iwdg_read(board, address - 0x40003000);
  if (address == 0x40007004) return board->pwr[1] | 0x34000; /* regulator ready, over-drive on */
  if (address == 0x40007000) return board->pwr[0];
  if (chip->is_f1 && within(address, 0x40006c04, 4 * 10))
    return board->backup[(address - 0x40006c04) / 4];
  if (!chip->is_f1 && within(address, 0x40002850, 4 * BACKUP_REGISTERS))
    return board->backup[(address - 0x40002850) / 4];
  return board->plain[(address - 0x40000000) / 4];
}

/* The backup registers stay as they are until PWR's CR says otherwise (DBP). */
static int backup_open(const board_t* board) { return board->pwr[0] >> 8 & 1; }

static void write_backup(board_t* board, uint32_t index, uint32_t value) {
  if (backup_open(board)) board->backup[index] = board->chip->is_f1 ? value & 0xffff : value;
}

static void peripheral_write(board_t* board, uint32_t address, uint32_t value) {
  const chip_t* chip = board->chip;
  if (!rcc_is_clocked(board, address)) return;
  if (within(address, chip->rcc, 0x100)) {
    rcc_write(board, address - chip->rcc, value);
  } else if (within(address, chip->flash, 0x100)) {
    flash_write(board, address - chip->flash, value);
  } else if (within(address, chip->gpio, chip->gpio_ports * 0x400)) {
    gpio_write(board, (int)(address - chip->gpio) / 0x400, address & 0x3ff, value);
  } else if (within(address, chip->usart[0], 0x20)) {
    usart_write(board, 0, address - chip->usart[0], value);
  } else if (within(address, chip->usart[1], 0x20)) {
    usart_write(board, 1, address - chip->usart[1], value);
  } else if (within(address, 0x40000400, 0x80)) {
    timer_write(board, address - 0x40000400, value);
  } else if (within(address, 0x40005400, 0x40)) {
    i2c_write(board, address - 0x40005400, value);
  } else if (within(address, 0x40003000, 0x10)) {
    iwdg_write(board, address - 0x40003000, value);
  } else if (within(address, 0x40007000, 8)) {
    board->pwr[(address - 0x40007000) / 4] = value;
  } else if (chip->is_f1 && within(address, 0x40006c04, 4 * 10)) {
    write_backup(board, (address - 0x40006c04) / 4, value);
  } else if (!chip->is_f1 && within(address, 0x40002850, 4 * BACKUP_REGISTERS)) {
    write_backup(board, (address - 0x40002850) / 4, value);
  } else {
    board->plain[(address - 0x40000000) / 4] = value;
  }
}

static uint64_t narrowed(uint32_t word, uint64_t offset, unsigned size) {
  word >>= 8 * (offset & 3);
  return size == 4 ? word : word & ((1u << 8 * size) - 1);
}

static uint32_t mask_of(uint64_t offset, unsigned size) {
  return (size == 4 ? 0xffffffff : (1u << 8 * size) - 1) << 8 * (offset & 3);
}

static uint64_t read_peripheral(uc_engine* uc, uint64_t offset, unsigned size, void* user) {
  (void)uc;
  return narrowed(peripheral_read(user, 0x40000000 + (offset & ~3u)), offset, size);
}

/* Most of ST's registers may be written in parts; data registers take what comes. */
static void write_peripheral(uc_engine* uc, uint64_t offset, unsigned size, uint64_t value,
                             void* user) {
  (void)uc;
  uint32_t address = 0x40000000 + (offset & ~3u), mask = mask_of(offset, size);
  uint32_t shifted = (uint32_t)value << 8 * (offset & 3);
  if (size != 4 && (offset & 3)) shifted |= peripheral_read(user, address) & ~mask;
  peripheral_write(user, address, shifted);
}

/* Each bit of the peripherals' memory as a word of its own. */
static uint64_t read_bit(uc_engine* uc, uint64_t offset, unsigned size, void* user) {
  (void)uc, (void)size;
  uint32_t bit = offset / 4, address = 0x40000000 + bit / 32 * 4;
  return peripheral_read(user, address) >> bit % 32 & 1;
}

static void write_bit(uc_engine* uc, uint64_t offset, unsigned size, uint64_t value, void* user) {
  (void)uc, (void)size;
  uint32_t bit = offset / 4, address = 0x40000000 + bit / 32 * 4;
  uint32_t word = peripheral_read(user, address) & ~(1u << bit % 32);
  peripheral_write(user, address, word | (uint32_t)(value & 1) << bit % 32);
}

static uint64_t read_core(uc_engine* uc, uint64_t offset, unsigned size, void* user) {
  (void)uc;
  return narrowed(core_read(user, offset & ~3u), offset, size);
}

static void write_core(uc_engine* uc, uint64_t offset, unsigned size, uint64_t value, void* user) {
  (void)uc;
  core_write(user, offset & ~3u, (uint32_t)value << 8 * (offset & 3), mask_of(offset, size));
}

/* The F4's USB device, with nothing plugged in: it is idle, and what is written stays. */
static uint64_t read_usb(uc_engine* uc, uint64_t offset, unsigned size, void* user) {
  (void)uc;
  board_t* board = user;
  uint32_t at = offset & 0x3fffc, word = board->usb[at / 4];
  if (at == 0x10) word = 1u << 31; /* GRSTCTL: the bus is idle, every reset and flush is over */
  if (at == 0x14) word = 0;        /* GINTSTS: device mode, no event */
  return narrowed(word, offset, size);
}

static void write_usb(uc_engine* uc, uint64_t offset, unsigned size, uint64_t value, void* user) {
  (void)uc, (void)size;
  board_t* board = user;
  board->usb[(offset & 0x3fffc) / 4] = (uint32_t)value;
}

static void map_memory(board_t* board) {
  uc_engine* uc = board->uc;
  const chip_t* chip = board->chip;
  uint32_t info_size = chip->is_f1 ? PAGE : 0x10000;
  uc_mem_map(uc, FLASH_BASE, chip->flash_size, UC_PROT_READ | UC_PROT_EXEC);
  uc_mem_map(uc, chip->info_base, info_size, UC_PROT_READ | UC_PROT_EXEC);
  uc_mem_map(uc, RAM_BASE, chip->ram_size, UC_PROT_ALL);
  uc_mmio_map(uc, 0x40000000, 0x80000, read_peripheral, board, write_peripheral, board);
  uc_mmio_map(uc, 0x42000000, 0x1000000, read_bit, board, write_bit, board);
  if (!chip->is_f1) uc_mmio_map(uc, 0x50000000, 0x40000, read_usb, board, write_usb, board);
  uc_mmio_map(uc, 0xe0000000, 0x100000, read_core, board, write_core, board);
  /* The boot loader: a stack, and a program that waits. */
  const uint32_t rom[] = {RAM_BASE + 0x2000, (chip->rom_base + 8) | 1, 0xe7fee7fe};
  uc_mem_write(uc, chip->rom_base, rom, sizeof rom);
  const uint32_t kilobytes = chip->flash_size >> 10;
  uc_mem_write(uc, chip->is_f1 ? 0x1ffff7e0 : 0x1fff7a22, &kilobytes, 2);
}

/* ---- the program */

static int load_segment(board_t* board, const Elf32_Phdr* segment, const uint8_t* bytes) {
  uint32_t offset = segment->p_paddr - FLASH_BASE;
  if (segment->p_type != PT_LOAD || segment->p_filesz == 0) return 1;
  if (offset > board->chip->flash_size || segment->p_filesz > board->chip->flash_size - offset)
    return 0;
  memcpy(board->image + offset, bytes + segment->p_offset, segment->p_filesz);
  return 1;
}

/* Variables end where the last of the sections .data and .bss ends. */
static void measure_variables(board_t* board, const uint8_t* elf, const Elf32_Ehdr* header) {
  const Elf32_Shdr* sections = (const Elf32_Shdr*)(elf + header->e_shoff);
  const char* names = (const char*)elf + sections[header->e_shstrndx].sh_offset;
  uint32_t end = RAM_BASE;
  for (int i = 0; i < header->e_shnum; i++) {
    const Elf32_Shdr* section = &sections[i];
    if (!(section->sh_flags & SHF_ALLOC) || !(section->sh_flags & SHF_WRITE)) continue;
    if (strcmp(names + section->sh_name, "._user_heap_stack") == 0) continue;
    if (!within(section->sh_addr, RAM_BASE, board->chip->ram_size)) continue;
    board->meters.static_bytes += section->sh_size;
    if (section->sh_addr + section->sh_size > end) end = section->sh_addr + section->sh_size;
  }
  board->stack_floor = (end + 3) & ~3u;
}

static uint8_t* read_file(const char* path, size_t* size) {
  FILE* file = fopen(path, "rb");
  if (!file) return NULL;
  fseek(file, 0, SEEK_END);
  *size = (size_t)ftell(file);
  rewind(file);
  uint8_t* bytes = malloc(*size + 1);
  size_t got = fread(bytes, 1, *size, file);
  fclose(file);
  if (got == *size) return bytes;
  free(bytes);
  return NULL;
}

static int is_arm(const uint8_t* elf, size_t size) {
  const Elf32_Ehdr* header = (const Elf32_Ehdr*)elf;
  if (size < sizeof *header || memcmp(elf, ELFMAG, SELFMAG) != 0) return 0;
  if (header->e_machine != EM_ARM || header->e_shstrndx >= header->e_shnum) return 0;
  if (header->e_phoff + (uint64_t)header->e_phnum * sizeof(Elf32_Phdr) > size) return 0;
  if (header->e_shoff + (uint64_t)header->e_shnum * sizeof(Elf32_Shdr) > size) return 0;
  const Elf32_Phdr* segments = (const Elf32_Phdr*)(elf + header->e_phoff);
  for (int i = 0; i < header->e_phnum; i++) {
    if ((uint64_t)segments[i].p_offset + segments[i].p_filesz > size) return 0;
  }
  return 1;
}

static int load(board_t* board, const char* path, char* error, size_t error_size) {
  size_t size;
  uint8_t* elf = read_file(path, &size);
  if (!elf || !is_arm(elf, size)) {
    snprintf(error, error_size, "cannot read an ARM program from %s", path);
    free(elf);
    return 0;
  }
  const Elf32_Ehdr* header = (const Elf32_Ehdr*)elf;
  const Elf32_Phdr* segments = (const Elf32_Phdr*)(elf + header->e_phoff);
  int fits = 1;
  for (int i = 0; i < header->e_phnum; i++) fits = fits && load_segment(board, &segments[i], elf);
  if (fits) measure_variables(board, elf, header);
  free(elf);
  if (!fits) snprintf(error, error_size, "%s does not fit into an %s", path, board->chip->name);
  return fits;
}

static void paint_memory(board_t* board) {
  memcpy(&board->stack_top, board->image, sizeof board->stack_top);
  uint32_t paint = PAINT;
  for (uint32_t at = board->stack_floor; at < RAM_BASE + board->chip->ram_size; at += 4)
    uc_mem_write(board->uc, at, &paint, 4);
}

/* ---- power and resets */

/* RAM, backup registers and what is on the lines stay; everything else begins anew. */
static void restart(board_t* board, uint32_t cause) {
  board->reset_flags |= cause;
  board->reset_wanted = board->in_rom = 0;
  board->reloads = 0;
  flash_reset(board);
  board->now += US(100); /* the reset pulse and the chip's own start */
  memset(&board->iwdg, 0, sizeof board->iwdg);
  board->iwdg.rlr = 0xfff;
  memset(board->pwr, 0, sizeof board->pwr);
  memset(board->plain, 0, sizeof board->plain);
  memset(board->usb, 0, sizeof board->usb);
  rcc_reset(board);
  timer_reset(board);
  i2c_reset(board);
  for (int i = 0; i < UARTS; i++) usart_reset(board, i);
  gpio_reset(board);
  core_reset(board);
}

static void restart_again(board_t* board, uint32_t cause) {
  board->meters.restarts++;
  restart(board, cause | PIN_RESET); /* every reset is seen on the pin */
}

board_t* board_power_on(const char* elf, const char* chip, uint32_t hz, char* error,
                        size_t error_size) {
  const chip_t* found = NULL;
  for (size_t i = 0; i < sizeof kChips / sizeof kChips[0]; i++) {
    if (strcmp(kChips[i].name, chip) == 0) found = &kChips[i];
  }
  if (!found) {
    snprintf(error, error_size, "the emulator does not know the chip %s", chip);
    return NULL;
  }
  board_t* board = calloc(1, sizeof *board);
  board->chip = found;
  board->crystal_hz = hz;
  board->slowness = 1;
  board->erase_us = found->erase_us;
  board->image = malloc(found->flash_size);
  memset(board->image, 0xff, found->flash_size);
  if (!core_create(board, error, error_size) || !load(board, elf, error, error_size)) {
    board_power_off(board);
    return NULL;
  }
  map_memory(board);
  uc_mem_write(board->uc, FLASH_BASE, board->image, found->flash_size);
  paint_memory(board);
  restart(board, POWER_RESET | PIN_RESET);
  return board;
}

void board_power_off(board_t* board) {
  if (board->uc) uc_close(board->uc);
  for (int i = 0; i < UARTS; i++) {
    inbox_free(&board->usarts[i].in);
    outbox_free(&board->usarts[i].out);
  }
  free(board->image);
  free(board);
}

/* ---- time */

static uint64_t earliest(uint64_t a, uint64_t b) { return a < b ? a : b; }

static uint64_t next_event(const board_t* board) {
  uint64_t due = earliest(core_due(board), iwdg_due(board));
  for (int i = 0; i < UARTS; i++) due = earliest(due, usart_due(board, i));
  return earliest(due, earliest(i2c_due(board), timer_due(board)));
}

static void step_devices(board_t* board) {
  flash_step(board);
  core_step_tick(board);
  for (int i = 0; i < UARTS; i++) {
    if (usart_due(board, i) <= board->now) usart_step(board, i);
  }
  i2c_step(board);
  if (timer_due(board) <= board->now) timer_step(board);
  if (iwdg_due(board) <= board->now) restart_again(board, WATCHDOG_RESET);
  if (board->reset_wanted) restart_again(board, SOFT_RESET);
}

/* While nothing runs, time goes to the next event. */
static void stand_still(board_t* board, uint64_t until) {
  uint64_t next = earliest(until, next_event(board));
  if (next > board->now) board->now = next;
}

int board_run_until(board_t* board, uint64_t tick) {
  uint64_t target = NS(tick);
  while (board->now < target) {
    if (board->fault[0]) return 1;
    step_devices(board);
    if (board->flash.busy_until > board->now) {
      stand_still(board, earliest(target, board->flash.busy_until));
    } else if (board->in_rom || board->locked_up) {
      stand_still(board, target);
    } else if (!core_take_exception(board)) {
      board->limit = earliest(target, next_event(board));
      core_run(board);
      if (board->halted) stand_still(board, target);
    }
  }
  return board->fault[0] != 0;
}

uint64_t board_tick(const board_t* board) { return board->now >> 10; }

uint32_t board_ticks_per_us(const board_t* board) {
  (void)board;
  return 1000;
}

const char* board_fault(const board_t* board) { return board->fault; }

/* ---- the boot loader in ROM: what it finds when the program jumps into it */

void board_enter_rom(board_t* board) {
  if (board->in_rom) return;
  board->in_rom = 1;
  const nvic_t* nvic = &board->nvic;
  const chip_t* chip = board->chip;
  int interrupts = 0;
  for (int i = 0; i < IRQS / 32; i++) interrupts |= nvic->enabled[i] != 0;
  snprintf(board->rom_complaint, sizeof board->rom_complaint, "%s%s%s%s%s%s",
           interrupts ? "an interrupt is enabled; " : "",
           nvic->tick_ctrl & 1 ? "the tick runs; " : "",
           board->iwdg.running ? "the watchdog runs; " : "",
           rcc_core_hz(board) != chip->hsi_hz ? "the clock is not the one after a reset; " : "",
           nvic->vtor != chip->rom_base ? "the vector table is not its own; " : "",
           core_register(board, UC_ARM_REG_PRIMASK) & 1 ? "interrupts are masked; " : "");
}

int board_in_rom(const board_t* board, char* complaint, size_t size) {
  snprintf(complaint, size, "%s", board->in_rom ? board->rom_complaint : "");
  return board->in_rom;
}

/* ---- pins, and what goes wrong on purpose */

int board_watch_pin(board_t* board, char port, int bit) {
  if (port < 'A' || port >= 'A' + (int)board->chip->gpio_ports || bit < 0 || bit > 15) return -1;
  if (board->watched_count == WATCHED) return -1;
  board->watched[board->watched_count].port = port;
  board->watched[board->watched_count++].bit = bit;
  gpio_renew(board);
  return board->watched_count - 1;
}

void board_read_pin(const board_t* board, int pin, board_pin_t* out) {
  *out = board->watched[pin].record.state;
}

size_t board_take_edges(board_t* board, int pin, board_edge_t* out, size_t size) {
  return take_edges(&board->watched[pin].record, out, size);
}

/* The chip's own number, from which the firmware takes its seed. */
void board_set_noise(board_t* board, uint32_t noise) {
  const uint32_t number[] = {noise, 0x20373256, 0x4d4b5001};
  uc_mem_write(board->uc, board->chip->unique_id, number, sizeof number);
}

void board_break_crystal(board_t* board) { board->crystal_broken = 1; }

void board_set_erase_us(board_t* board, uint32_t us) { board->erase_us = us; }

void board_set_slowness(board_t* board, uint32_t times) { board->slowness = times ? times : 1; }

/* ---- meters */

void board_count_turn(board_t* board) {
  if (++board->reloads > STARTING_RELOADS) {
    uint64_t ticks = (board->now - board->turn_start) >> 10;
    board->meters.turns++;
    if (ticks > board->meters.longest_ticks) board->meters.longest_ticks = ticks;
  }
  board->turn_start = board->now;
}

/* The longest stretch that was never written lies between the heap and the stack. */
void board_read_meters(const board_t* board, board_meters_t* out) {
  uint32_t size = board->stack_top - board->stack_floor, run = 0, longest = 0;
  uint32_t* words = calloc(size / 4 + 1, 4);
  uc_mem_read(board->uc, board->stack_floor, words, size & ~3u);
  for (uint32_t i = 0; i < size / 4; i++) {
    run = words[i] == PAINT ? run + 4 : 0;
    if (run > longest) longest = run;
  }
  free(words);
  *out = board->meters;
  out->stack_headroom = longest;
}

void board_clear_meters(board_t* board) {
  board->meters.turns = board->meters.longest_ticks = 0;
  board->meters.bus_clocks = board->meters.bus_stops = 0;
}

/* See Arduino.h. */
#define WDTO_15MS 0
#define WDTO_250MS 4

void wdt_enable(uint8_t time);
void wdt_reset();

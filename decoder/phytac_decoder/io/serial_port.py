"""A raw serial port, by the standard library."""

import os
from pathlib import Path

from phytac_shapes.errors import InputError


class SerialPort:
    """A serial device that is written without blocking.

    Parameters
    ----------
    path : Path
        Device, such as ``/dev/ttyUSB0``.
    baud : int
        Bits a second, eight data bits, no parity, one stop bit.

    Raises
    ------
    InputError
        If it is no serial device, cannot be opened, or has no such rate.
    """

    def __init__(self, path: Path, *, baud: int = 115200) -> None:
        try:
            import termios
            import tty
        except ImportError:
            raise InputError(
                "serial-unsupported",
                "serial ports need a POSIX system; leave --serial out and forward the TCP stream",
            ) from None
        rates = {
            int(name[1:]): getattr(termios, name)
            for name in dir(termios)
            if name[0] == "B" and name[1:].isdecimal() and int(name[1:]) > 0
        }
        if baud not in rates:
            near = sorted(sorted(rates, key=lambda rate: abs(rate - baud))[:3])
            raise InputError(
                "serial-baud-rate",
                f"no rate of {baud} bits a second; nearest: {', '.join(map(str, near))}",
            )
        self.name = str(path)
        try:
            self._handle = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            raise InputError(
                "serial-not-opened",
                f"serial port {path} cannot be opened ({error.strerror}); is it plugged in, and "
                "may you write to it?",
            ) from None
        try:
            tty.setraw(self._handle)
            settings = termios.tcgetattr(self._handle)
            # Raw leaves the stop bits and the flow control of whoever used it before.
            settings[2] &= ~(termios.CSTOPB | termios.PARENB | getattr(termios, "CRTSCTS", 0))
            settings[2] |= termios.CLOCAL | termios.CREAD
            settings[4] = settings[5] = rates[baud]
            termios.tcsetattr(self._handle, termios.TCSANOW, settings)
        except termios.error as error:
            self.close()
            raise InputError(
                "serial-not-a-port",
                f"{path} is no serial port ({error.args[-1]}); give a device such as /dev/ttyUSB0",
            ) from None

    def fileno(self) -> int:
        """The open device."""
        return self._handle

    def close(self) -> None:
        """Close the device."""
        os.close(self._handle)

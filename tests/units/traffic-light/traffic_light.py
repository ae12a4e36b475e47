"""A traffic light for injection: throttles a rate by what is seen of the fault.

The signal (slip tendency, or a magnitude) switches the light up as soon as it reaches a threshold, and down again only when
it is more than `hysteresis` below that. Green injects at the full rate, yellow at half of it, red not at all. The unit is
asked once after each time step; its answer holds for the next.
"""

from pythonfmu3 import Fmi3Slave

from arrays import DONE, Arrays

GREEN, YELLOW, RED = 0, 1, 2
PART_OF_RATE = [1.0, 0.5, 0.0]


class TrafficLight(Arrays, Fmi3Slave):
    """The signal comes in, the rate goes out."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.description = "Throttles an injection by a signal: green, yellow, red"
        self.parameter("full_rate", "m2/s", 0.0, "Rate at green")
        self.parameter("yellow", "1", 0.88, "Signal from which the light is yellow")
        self.parameter("red", "1", 0.92, "Signal from which it is red")
        self.parameter("hysteresis", "1", 0.03, "Fall below a threshold at which the light goes back")
        self.input("signal", "1", 0.0, "What is watched; minus infinity is nothing, as a magnitude without slip")
        self.output("rate", "m2/s", 0.0, "Rate to inject at")
        self.output("light", "1", GREEN, "0 green, 1 yellow, 2 red")

    def exit_initialization_mode(self):
        if not self.scalar("yellow") < self.scalar("red"):
            raise ValueError("yellow must be below red")
        self.put("rate", self.scalar("full_rate"))

    def do_step(self, current_time, step_size):
        signal, light = self.scalar("signal"), int(self.scalar("light"))
        # The color at this signal from below, and from above.
        rising, falling = self._color(signal), self._color(signal + self.scalar("hysteresis"))
        light = max(rising, min(light, falling))
        self.put("light", light)
        self.put("rate", PART_OF_RATE[light] * self.scalar("full_rate"))
        return DONE

    def _color(self, signal):
        if signal < self.scalar("yellow"):
            return GREEN
        return YELLOW if signal < self.scalar("red") else RED

"""German texts of the interface, by the English ones."""

GERMAN: dict[str, str] = {
    '"{name}" is active, but hidden in the view: its eye in the list shows it': (
        "„{name}“ ist aktiv, aber in der Ansicht ausgeblendet: sein Auge in der Liste blendet es ein"
    ),
    '"{name}" is active, but not there at this time': "„{name}“ ist aktiv, aber zu dieser Zeit nicht da",
    '"{name}" is in a collection that this view layer leaves out': (
        "„{name}“ ist in einer Sammlung, die diese Ansichtsebene auslässt"
    ),
    '"{name}" is not in this view layer': "„{name}“ ist nicht in dieser Ansichtsebene",
    '"{name}" is not there any more': "„{name}“ ist nicht mehr da",
    '"{name}" no longer exists': "„{name}“ existiert nicht mehr",
    ", {rate:.1f} units/min": ", {rate:.1f} Einheiten/min",
    ", {rate:.2f} frames/s": ", {rate:.2f} Bilder/s",
    ", {rate:.2f} steps/s": ", {rate:.2f} Schritte/s",
    "1 LiDAR": "1 LiDAR",
    "1 actor": "1 Akteur",
    "1 beam": "1 Strahl",
    "1 camera": "1 Kamera",
    "1 edit": "1 Änderung",
    "1 listed frame": "1 aufgezähltes Bild",
    "1 sensor at times of its own": "1 Sensor mit eigenen Zeitpunkten",
    "1 time": "1 Zeitpunkt",
    "A GPU if the interpreter supports one, otherwise the CPU": (
        "Eine GPU, falls der Interpreter eine unterstützt, sonst die CPU"
    ),
    "A click goes to the nearest frame at which the actor is there": (
        "Ein Klick geht zum nächsten Bild, in dem der Akteur da ist"
    ),
    "A click turns the view to the actor; a view through a camera that has it in its image stays": (
        "Ein Klick wendet die Ansicht zum Akteur; eine Ansicht durch eine Kamera, die ihn im Bild hat, bleibt"
    ),
    "A driver of your own: a function of a module": "Ein eigener Fahrer: eine Funktion eines Moduls",
    "A process that speaks AlpaSim's protocol of drivers, at an address": (
        "Ein Prozess, der AlpaSims Protokoll für Fahrer spricht, an einer Adresse"
    ),
    "About": "Beschreibung",
    "Acceleration": "Beschleunigung",
    "Acceleration across": "Querbeschleunigung",
    "Acceleration along": "Längsbeschleunigung",
    "Active Camera": "Aktive Kamera",
    "Actor": "Akteur",
    "Actor of a Trained Scene": "Akteur einer trainierten Szene",
    "Actor of the Drive": "Akteur der Fahrt",
    "Actor that each pixel shows": "Akteur, den jedes Pixel zeigt",
    "Actor to insert": "Akteur, der eingefügt wird",
    "Actor whose appearance is used": "Akteur, dessen Aussehen verwendet wird",
    "Actor whose appearance this object has; empty for its own": (
        "Akteur, dessen Aussehen dieses Objekt hat; leer für das eigene"
    ),
    "Actors": "Akteure",
    "Actors duplicated: {count}": "Akteure dupliziert: {count}",
    "Actors in Simulations": "Akteure in Simulationen",
    "Actors of every class": "Akteure aller Klassen",
    "Actors start up to so much earlier or later": "So viel früher oder später starten Akteure höchstens",
    "Actors with this model: {count}": "Akteure mit diesem Modell: {count}",
    "Actors: {actors}, sensors: {sensors}": "Akteure: {actors}, Sensoren: {sensors}",
    "Add": "Hinzufügen",
    "Add Camera": "Kamera hinzufügen",
    "Add LiDAR": "LiDAR hinzufügen",
    "Add Parameter": "Parameter hinzufügen",
    "Add a LiDAR to the vehicle": "Dem Fahrzeug ein LiDAR hinzufügen",
    "Add a camera to the vehicle and make it the active camera": (
        "Dem Fahrzeug eine Kamera hinzufügen und sie aktivieren"
    ),
    "Add a parameter: a field of the scenario that the batch fills with several values": (
        "Einen Parameter hinzufügen: ein Feld des Szenarios, das der Stapel mit mehreren Werten füllt"
    ),
    "Address": "Adresse",
    "Aim": "Ausrichten",
    "Aim Sensor": "Sensor ausrichten",
    "All": "Alle",
    "All Sensors": "Alle Sensoren",
    "All actors are listed already": "Es sind schon alle Akteure gelistet",
    "All cameras and LiDARs of the scene": "Alle Kameras und LiDARs der Szene",
    "All of the rig, along the vehicle: forward, left, up": (
        "Das ganze Rig, entlang des Fahrzeugs: vorwärts, links, oben"
    ),
    "All others": "Alle anderen",
    "Along": "Längs",
    "Along Path": "Entlang des Pfads",
    "Along the recorded path by keys of speed and displacement, whatever is in the way": (
        "Auf dem aufgezeichneten Pfad nach Schlüsseln von Geschwindigkeit und Versatz, was auch im Weg ist"
    ),
    "Along the recorded path by the Intelligent Driver Model, behind what is in the way": (
        "Auf dem aufgezeichneten Pfad nach dem Intelligent Driver Model, hinter allem, was im Weg ist"
    ),
    "Along the recorded path, behind what is in the way; it is told where everything is": (
        "Auf dem aufgezeichneten Pfad, hinter allem, was im Weg ist; er erfährt, wo alles ist"
    ),
    "Along world X or Y, whichever the object is longer in": "Entlang X oder Y der Welt, wo das Objekt länger ist",
    "AlpaSim Driver": "AlpaSim-Fahrer",
    "Always": "Immer",
    "And {count} more": "Und {count} weitere",
    "Annotated object: a car, a pedestrian, a cone": "Annotiertes Objekt: ein Auto, ein Fußgänger, ein Leitkegel",
    "Another task is running: cancel it or wait until it ends": (
        "Eine andere Aufgabe läuft: abbrechen oder ihr Ende abwarten"
    ),
    "Appearance": "Aussehen",
    "Appearance of {actor}": "Aussehen von {actor}",
    "Appearance scene": "Szene des Aussehens",
    "Apple GPU": "Apple-GPU",
    "Apply Rig Preset": "Rig-Preset anwenden",
    "Applying the edits (Esc to cancel)": "Änderungen werden angewandt (Esc bricht ab)",
    "As All Others": "Wie alle anderen",
    "As Replay, Then Follow, and changes into the path of the ego vehicle once it is ahead of it": (
        "Wie Abspielen, dann folgen, und wechselt in den Pfad des Ego-Fahrzeugs, sobald er davor ist"
    ),
    "As Replay, Then Follow, and drives to where the ego vehicle will be once that is near (seeded)": (
        "Wie Abspielen, dann folgen, und fährt dorthin, wo das Ego-Fahrzeug sein wird, sobald es nah ist (mit "
        "Startwert)"
    ),
    "As Replay, Then Follow, and on along paths of other actors where its own path ends": (
        "Wie Abspielen, dann folgen, und weiter auf Pfaden anderer Akteure, wo der eigene endet"
    ),
    "As Sequences": "Wie Sequenzen",
    "As recorded until the ego vehicle leaves its log or a conflict is foreseen, then Follow": (
        "Wie aufgezeichnet, bis das Ego-Fahrzeug sein Log verlässt oder ein Konflikt absehbar ist, dann Folgen"
    ),
    "As recorded; pedestrians stop before a vehicle in their way": (
        "Wie aufgezeichnet; Fußgänger halten vor einem Fahrzeug in ihrem Weg"
    ),
    "As the log's labels have it: Car, Pickup Truck, Bus …": "Wie in den Labels des Logs: Car, Pickup Truck, Bus …",
    "Aside": "Quer",
    "At": "Ort",
    "At the 3D cursor": "Am 3D-Cursor",
    "At the 3D cursor in the current frame, on the same trajectory": (
        "Am 3D-Cursor im aktuellen Bild, auf derselben Trajektorie"
    ),
    "At the location of the source, to be moved with Blender's tools": "Am Ort der Quelle, zum Verschieben mit Blender",
    "At {time:.1f} s": "Bei {time:.1f} s",
    "Attack": "Angriff",
    "Attribute that colours LiDAR points": "Attribut, nach dem LiDAR-Punkte gefärbt werden",
    "Automatic": "Automatisch",
    "Balanced": "Ausgewogen",
    "Batch": "Stapel",
    "Beam table": "Strahlentabelle",
    "Beams": "Strahlen",
    "Beside the sensors that are there": "Zusätzlich zu den vorhandenen Sensoren",
    "Beside, left": "Daneben, links",
    "Beside, right": "Daneben, rechts",
    "Bicycles, motorcycles, scooters": "Fahrräder, Motorräder, Roller",
    "Blender runs as a Python module, which has no animation player": (
        "Blender läuft als Python-Modul, das keinen Animationsplayer hat"
    ),
    "Body": "Karosserie",
    "Body of the ego vehicle": "Karosserie des Ego-Fahrzeugs",
    "Both": "Beide",
    "Box": "Quader",
    "Box around an object without annotation": "Quader um ein Objekt ohne Annotation",
    "Box around the item, as JSON": "Quader um das Objekt, als JSON",
    "Braking": "Bremsen",
    "Built-in": "Eingebaut",
    "Built-in: none yet": "Eingebaut: noch keine",
    "By name, numbers by their value": "Nach Name, Zahlen nach ihrem Wert",
    "Camera": "Kamera",
    "Camera names separated by commas, or all; empty for the one that faces ahead": (
        "Kameranamen durch Kommas getrennt, oder all; leer für die, die nach vorn blickt"
    ),
    "Camera of the vehicle": "Kamera des Fahrzeugs",
    "Camera on the Vehicle": "Kamera am Fahrzeug",
    "Camera whose images are played": "Kamera, deren Bilder abgespielt werden",
    "Cameras": "Kameras",
    "Cancel": "Abbrechen",
    "Cancel Sequence or Training": "Sequenz oder Training abbrechen",
    "Cars": "Autos",
    "Cars and pickup trucks": "Autos und Pick-ups",
    "Change Beams": "Strahlen ändern",
    "Change takes": "Wechsel dauert",
    "Change the beam table of the selected LiDARs": "Die Strahlentabelle der ausgewählten LiDARs ändern",
    "Change the speed between two times; later keyframes shift accordingly": (
        "Die Geschwindigkeit zwischen zwei Zeiten ändern; spätere Schlüsselbilder verschieben sich entsprechend"
    ),
    "Change the speed from the current frame on": "Die Geschwindigkeit ab dem aktuellen Bild ändern",
    "Change when the selected actors are where on their trajectories": (
        "Ändern, wann die ausgewählten Akteure wo auf ihren Trajektorien sind"
    ),
    "Changed: {who}": "Geändert: {who}",
    "Changes whenever the LiDAR points change": "Ändert sich, sobald sich die LiDAR-Punkte ändern",
    "Check": "Prüfung",
    "Check Edits": "Änderungen prüfen",
    "Checked": "Geprüft",
    "Checking scenarios": "Szenarien werden geprüft",
    "Choose another trained scene, and insert one of its actors at the 3D cursor": (
        "Eine andere trainierte Szene wählen und einen ihrer Akteure am 3D-Cursor einfügen"
    ),
    "Class": "Klasse",
    "Class name as in the labels of the log, for example Car, Pedestrian or Cones": (
        "Klassenname wie in den Labels des Logs, zum Beispiel Car, Pedestrian oder Cones"
    ),
    "Class of a mesh actor": "Klasse eines Mesh-Akteurs",
    "Classes that are listed": "Klassen, die gelistet werden",
    "Classes that are shown": "Klassen, die gezeigt werden",
    "Clear Filter": "Filter zurücksetzen",
    "Click the image to choose": "Zum Auswählen das Bild anklicken",
    "Click to select it and to go to a frame at which it shows": (
        "Klicken, um es auszuwählen und zu einem Bild zu gehen, in dem die Änderung zu sehen ist"
    ),
    "Clip to Observed": "Auf Beobachtetes beschneiden",
    "Clipped to what was observed": "Auf Beobachtetes beschnitten",
    "Collision: static scene": "Kollision: statische Szene",
    "Collision: {name}": "Kollision: {name}",
    "Collisions": "Kollisionen",
    "Colour": "Farbe",
    "Colour by": "Färben nach",
    "Colours are already shown as recorded": "Farben werden schon wie aufgezeichnet gezeigt",
    "Columns": "Spalten",
    "Comfort": "Komfort",
    "Comfortable deceleration": "Bequeme Verzögerung",
    "Compact": "Kompakt",
    "Compare the edits of this variant with those of the shown variant, or end the comparison": (
        "Die Änderungen dieser Variante mit denen der gezeigten vergleichen oder den Vergleich beenden"
    ),
    "Compare with Shown Variant": "Mit gezeigter Variante vergleichen",
    "Cones, signs, animals and the rest": "Leitkegel, Schilder, Tiere und der Rest",
    "Constant": "Konstant",
    "Contact shadows": "Kontaktschatten",
    "Contains": "Inhalt",
    "Copied, in place": "Kopiert, an Ort und Stelle",
    "Copied: {how}": "Kopiert: {how}",
    "Copy Static Item": "Statisches Objekt kopieren",
    "Copy the scene as a new, independent variant of the scenario and show it": (
        "Die Szene als neue, unabhängige Variante des Szenarios kopieren und diese zeigen"
    ),
    "Copy the selected static items to the 3D cursor": "Die ausgewählten statischen Objekte an den 3D-Cursor kopieren",
    "Copy to 3D Cursor": "An den 3D-Cursor kopieren",
    "Cost of others": "Kosten anderer",
    "Count": "Anzahl",
    "Current Location": "Aktuelle Position",
    "Curvature (1/m)": "Krümmung (1/m)",
    "Custom": "Eigene",
    "Custom elevation angles": "Eigene Elevationswinkel",
    "Cut In": "Einscheren",
    "Cut-in gap": "Einscherabstand",
    "Cut-in headway": "Einscherzeitlücke",
    "Decides every": "Entscheidet alle",
    "Degrees to the left of the vehicle's axis": "Grad nach links von der Achse des Fahrzeugs",
    "Degrees up": "Grad nach oben",
    "Delay": "Verzögern",
    "Delay or duration of the stop, in seconds of the log": "Verzögerung oder Dauer des Halts, in Sekunden des Logs",
    "Delay the whole trajectory": "Die ganze Trajektorie verzögern",
    "Delete": "Löschen",
    "Delete Actor": "Akteur löschen",
    "Delete Variant": "Variante löschen",
    "Delete the file of a rig preset; sensors on vehicles are kept": (
        "Die Datei eines Rig-Presets löschen; Sensoren an Fahrzeugen bleiben erhalten"
    ),
    "Delete the selected actors and static items from all images and sweeps": (
        "Die ausgewählten Akteure und statischen Objekte aus allen Bildern und Sweeps löschen"
    ),
    "Delete the shown variant with all its objects and keyframes, and show another one": (
        "Die gezeigte Variante mit allen Objekten und Schlüsselbildern löschen und eine andere zeigen"
    ),
    "Delete {name} with its objects and keyframes?": "{name} mit allen Objekten und Schlüsselbildern löschen?",
    "Departure": "Abweichung",
    "Depth": "Tiefe",
    "Device": "Gerät",
    "Device that the renderer uses": "Gerät, das der Renderer verwendet",
    "Difference": "Differenz",
    "Digest of the edits that were checked; empty before the first check": (
        "Prüfsumme der geprüften Änderungen; leer vor der ersten Prüfung"
    ),
    "Direction": "Richtung",
    "Displace Trajectory": "Trajektorie verschieben",
    "Displace the trajectory of the ego vehicle and its sensors to the left or right": (
        "Die Trajektorie des Ego-Fahrzeugs mit seinen Sensoren nach links oder rechts verschieben"
    ),
    "Displacement to the left; negative values displace to the right": (
        "Verschiebung nach links; negative Werte verschieben nach rechts"
    ),
    "Distance": "Abstand",
    "Distance along each ray and along the optical axis": (
        "Abstand entlang jedes Strahls und entlang der optischen Achse"
    ),
    "Distance from the ego vehicle within which it attacks": "Entfernung vom Ego-Fahrzeug, in der er angreift",
    "Distance from the sensor, from blue to red (80 m)": "Abstand vom Sensor, von Blau bis Rot (80 m)",
    "Distance to the next lane": "Abstand zur nächsten Spur",
    "Distance to what is ahead at rest": "Abstand zum Vordermann im Stand",
    "Done: {progress}": "Fertig: {progress}",
    "Drag the active actor's trajectory at this time in the ground plane; the change blends in and out over two seconds": (
        "Die Trajektorie des aktiven Akteurs zu dieser Zeit in der Bodenebene ziehen; die Änderung wird über zwei Sekunden "
        "ein- und ausgeblendet"
    ),
    "Drag the ego vehicle with its sensors sideways into another lane, alike at every time": (
        "Das Ego-Fahrzeug mit seinen Sensoren seitwärts in eine andere Spur ziehen, zu jeder Zeit gleich"
    ),
    "Drag to aim the active sensor: its mount rotates by yaw and pitch": (
        "Ziehen, um den aktiven Sensor auszurichten: seine Montage dreht sich um Gier- und Nickwinkel"
    ),
    "Drag to displace {name} at {time} in the ground plane; the change blends in and out over 2 s on both sides": (
        "Ziehen, um {name} bei {time} in der Bodenebene zu verschieben; die Änderung wird beidseitig über 2 s ein- und "
        "ausgeblendet"
    ),
    "Draw a bar over the lower part of the view for each actor while it is present; a click on a bar goes there": (
        "Über den unteren Teil der Ansicht für jeden Akteur einen Balken zeichnen, solange er anwesend ist; ein Klick auf "
        "einen Balken geht dorthin"
    ),
    "Draw the plan of the driver at the current frame of an opened rollout": (
        "Den Plan des Fahrers beim aktuellen Bild eines geöffneten Rollouts zeichnen"
    ),
    "Draw the recorded boxes of what an opened rollout has elsewhere, and the recorded path of the vehicle": (
        "Die aufgezeichneten Boxen dessen zeichnen, was ein geöffneter Rollout anderswo hat, und den "
        "aufgezeichneten Pfad des Fahrzeugs"
    ),
    (
        "Draw the speed of the active actor, or of the ego vehicle, over the drive's seconds into the view's corner: "
        "recorded grey, edited blue, red where a limit is exceeded"
    ): (
        "Die Geschwindigkeit des aktiven Akteurs oder des Ego-Fahrzeugs über die Sekunden der Fahrt in die Ecke der "
        "Ansicht zeichnen: aufgezeichnet grau, geändert blau, rot bei überschrittenem Grenzwert"
    ),
    "Draw trajectories of the selected actors with their speed, and the recorded trajectories": (
        "Trajektorien der ausgewählten Akteure mit ihrer Geschwindigkeit zeichnen, dazu die aufgezeichneten"
    ),
    "Draws among": "Zieht unter",
    "Drive": "Fahrt",
    "Drive On from Here": "Ab hier weiterfahren",
    "Driver": "Fahrer",
    "Driver: {name}": "Fahrer: {name}",
    "Driving Log (folder)": "Fahrtlog (Ordner)",
    "Duplicate": "Duplizieren",
    "Duplicate Actor": "Akteur duplizieren",
    "Duplicate the selected actors with their trajectories": (
        "Die ausgewählten Akteure mit ihren Trajektorien duplizieren"
    ),
    "Duration": "Dauer",
    "Each of a list of values": "Jeder aus einer Liste von Werten",
    "Earliest first": "Früheste zuerst",
    "Edit Handles": "Griffe zum Bearbeiten",
    "Edited": "Geändert",
    "Edited since the check": "Seit der Prüfung geändert",
    "Edits": "Änderungen",
    "Ego": "Ego",
    "Ego body": "Ego-Karosserie",
    "Ego vehicle": "Ego-Fahrzeug",
    "Elevation angles of custom beams in degrees, separated by commas": (
        "Elevationswinkel eigener Strahlen in Grad, durch Kommas getrennt"
    ),
    "Elevations": "Elevationen",
    "End time, in seconds of the log": "Endzeit, in Sekunden des Logs",
    "Every pixel is traced individually, in steps of centimetres": (
        "Jedes Pixel wird einzeln verfolgt, in Schritten von Zentimetern"
    ),
    "Exact Street": "Exakte Straße",
    "Exact intrinsics or beam table, as JSON": "Genaue intrinsische Parameter oder Strahlentabelle, als JSON",
    "Exponent": "Exponent",
    "Export Scenario": "Szenario exportieren",
    "Export Variants": "Varianten exportieren",
    "F12 through a camera that the log does not have shows nothing but what the recording observed, on transparent ground": (
        "F12 durch eine Kamera, die das Log nicht hat, zeigt nur, was die Aufzeichnung beobachtet hat, auf transparentem Grund"
    ),
    "Factor of the original speed": "Faktor der ursprünglichen Geschwindigkeit",
    "Fast": "Schnell",
    "Field": "Feld",
    "Field of the scenario": "Feld des Szenarios",
    "File Path": "Dateipfad",
    "Filepath used for exporting the file": "Dateipfad, in den die Datei exportiert wird",
    "Find an interpreter that can render and show its capabilities": (
        "Einen Interpreter suchen, der rendern kann, und seine Fähigkeiten zeigen"
    ),
    "Fine": "Fein",
    "Firings per revolution of custom beams": "Schüsse je Umdrehung eigener Strahlen",
    "First": "Erster",
    "First row": "Erste Zeile",
    "First row of the presence timeline": "Erste Zeile der Anwesenheitsleiste",
    "First value": "Erster Wert",
    "Flicker": "Wechseln",
    "Folder": "Ordner",
    "Folder of rollouts; each gets its own in it": "Ordner der Rollouts; jeder bekommt darin seinen eigenen",
    "Folder of the batch, or the URL of an object store: s3://bucket/batch": (
        "Ordner des Stapels oder URL eines Objektspeichers: s3://bucket/batch"
    ),
    "Folder of the neural scene trained on the log": "Ordner der neuronalen Szene, die mit dem Log trainiert wurde",
    "Folder of the recorded drive": "Ordner der aufgezeichneten Fahrt",
    "Folder of the trained scene": "Ordner der trainierten Szene",
    "Folder of the trained scene; empty for the one of the drive": (
        "Ordner der trainierten Szene; leer für die der Fahrt"
    ),
    "Follow (IDM)": "Folgen (IDM)",
    "Follow Curve": "Kurve folgen",
    "Follow, On Past the End": "Folgen, über das Ende hinaus",
    "For Rendered shading by UniSim": "Für die Schattierung „Gerendert“ von UniSim",
    "For images that are learnt and rendered 1920 wide": (
        "Für Bilder, die mit 1920 Pixeln Breite gelernt und gerendert werden"
    ),
    "For scenes of a few megabytes": "Für Szenen von wenigen Megabytes",
    "For tests": "Für Tests",
    "For training on two processor cores": "Für Training auf zwei Prozessorkernen",
    "Forecast": "Vorhersage",
    "Forget": "Markierung entfernen",
    (
        "Forward by this length of the trajectory's path, round its turns, and straight on beyond its ends; actors that do "
        "not move are shifted along their own axis; negative values shift backward"
    ): (
        "Um diese Länge auf dem Pfad der Trajektorie vorwärts, um ihre Kurven herum und jenseits ihrer Enden geradeaus; "
        "Akteure, die sich nicht bewegen, werden entlang ihrer eigenen Achse verschoben; negative Werte verschieben "
        "rückwärts"
    ),
    "Forward direction of the object": "Vorwärtsrichtung des Objekts",
    "Frame": "Bild",
    "Frame range for which the captures of the imported scenario hold: first frame, last frame, step": (
        "Bildbereich, für den die Aufnahmen des importierten Szenarios gelten: erstes Bild, letztes Bild, Schrittweite"
    ),
    "Frame {frame:g} is outside the drive (frames {first:g} to {last:g}): nothing was recorded there": (
        "Bild {frame:g} liegt außerhalb der Fahrt (Bilder {first:g} bis {last:g}): dort wurde nichts aufgezeichnet"
    ),
    "Frame {frame}: {sensors} recorded no image": "Bild {frame}: {sensors} hat kein Kamerabild aufgezeichnet",
    "Frame {frame}: {sensors} recorded no sweep": "Bild {frame}: kein aufgezeichneter Sweep von {sensors}",
    "Frames": "Bilder",
    "Frames as START:STOP:STEP": "Bilder als START:STOP:SCHRITT",
    "Frames of the scenario": "Bilder des Szenarios",
    "Frames {first} to {last}": "Bilder {first} bis {last}",
    "Frames, times and more of the imported scenario, as JSON; empty where it states none": (
        "Bilder, Zeitpunkte und mehr des importierten Szenarios, als JSON; leer, wo es keine nennt"
    ),
    "From": "Von",
    "From ({first:g} s) must be earlier than To ({last:g} s)": "Von ({first:g} s) muss vor Bis ({last:g} s) liegen",
    "From blue (low) to yellow (high)": "Von Blau (niedrig) bis Gelb (hoch)",
    "From {start:g} s, {rate:g} Hz": "Ab {start:g} s, {rate:g} Hz",
    "From {start} to {end}": "Von {start} bis {end}",
    "From {time} on": "Ab {time}",
    "Function": "Funktion",
    "Gain": "Verstärkung",
    "Gap": "Abstand",
    "Give the selected actors the model of the active one, with its parameters": (
        "Den ausgewählten Akteuren das Modell des aktiven geben, mit dessen Parametern"
    ),
    "Go to Edit": "Zur Änderung gehen",
    "Go to Warning": "Zur Warnung gehen",
    "Go to a frame after the start of the rollout and before its end": (
        "Zuerst zu einem Bild nach dem Anfang des Rollouts und vor seinem Ende gehen"
    ),
    "Go to the frame of a warning, select its object and show it": (
        "Zum Bild einer Warnung gehen, ihr Objekt auswählen und zeigen"
    ),
    "Handles for the ego vehicle's lane, the active actor's trajectory and the active sensor's direction": (
        "Griffe für die Spur des Ego-Fahrzeugs, die Trajektorie des aktiven Akteurs und die Richtung des aktiven Sensors"
    ),
    "Hatch pixels in red that show what nothing recorded supports": (
        "Pixel rot schraffieren, deren Inhalt nichts Aufgezeichnetes stützt"
    ),
    "Headway": "Zeitlücke",
    "Height": "Höhe",
    "Hesai Pandar64: 64 beams, dense about the horizon, 0.2 degrees from column to column": (
        "Hesai Pandar64: 64 Strahlen, dicht um den Horizont, 0,2 Grad von Spalte zu Spalte"
    ),
    "Hidden parent that carries the recorded keyframes of a moving object": (
        "Verborgenes übergeordnetes Objekt, das die aufgezeichneten Schlüsselbilder eines bewegten Objekts trägt"
    ),
    "Hide Actor in the View": "Akteur in der Ansicht ausblenden",
    "Hide or show an actor in the view; images and sweeps are not affected": (
        "Einen Akteur in der Ansicht aus- oder einblenden; Bilder und Sweeps sind nicht betroffen"
    ),
    "Horizon": "Horizont",
    "Horizontal FOV": "Horizontales Sichtfeld",
    "Horizontal field of view in degrees": "Horizontales Sichtfeld in Grad",
    "How all moving actors move that have no model of their own": (
        "Wie sich alle fahrenden Akteure ohne eigenes Modell bewegen"
    ),
    "How far ahead conflicts are foreseen": "Wie weit voraus Konflikte absehbar sind",
    "How far ahead it compares drives": "Wie weit voraus er Fahrten vergleicht",
    "How far the object was lifted along its own axis for its scale": (
        "Wie weit das Objekt wegen seiner Skalierung entlang seiner eigenen Achse angehoben wurde"
    ),
    "How far the rendered image is from the recorded one, each colour by itself": (
        "Wie weit das gerenderte Bild vom aufgezeichneten entfernt ist, jede Farbe für sich"
    ),
    "How late the acceleration fades towards the speed": "Wie spät die Beschleunigung zur Geschwindigkeit hin abnimmt",
    "How the actor moves in a simulation": "Wie sich der Akteur in einer Simulation bewegt",
    "How the values are given": "Wie die Werte angegeben sind",
    "IDM (privileged)": "IDM (privilegiert)",
    "Id": "ID",
    "Identifier in scenarios, for objects that were copied with a variant": (
        "Bezeichner in Szenarien, für Objekte, die mit einer Variante kopiert wurden"
    ),
    "Identifier in the log or the scenario": "Bezeichner im Log oder im Szenario",
    "Image": "Bild",
    "Image height": "Bildhöhe",
    "Image width": "Bildbreite",
    "Image width in pixels; 0 for the recorded width": "Bildbreite in Pixeln; 0 für die aufgezeichnete Breite",
    "Image width of sequences in pixels; 0 for the width of each camera": (
        "Bildbreite von Sequenzen in Pixeln; 0 für die Breite jeder Kamera"
    ),
    "Images: {count}": "Bilder: {count}",
    "Import Driving Log": "Fahrtlog importieren",
    "Import Scenario": "Szenario importieren",
    "Import Trained Neural Scene": "Trainierte neuronale Szene importieren",
    "Import Trained Scene": "Trainierte Szene importieren",
    "Import a drive first: there is no ego vehicle": "Zuerst eine Fahrt importieren: es gibt kein Ego-Fahrzeug",
    "Import a driving log or a trained scene first": "Zuerst ein Fahrtlog oder eine trainierte Szene importieren",
    "Import a trained neural scene and its drive, with refined tracklets": (
        "Eine trainierte neuronale Szene und ihre Fahrt importieren, mit verfeinerten Tracklets"
    ),
    "Import cancelled: the scene is unchanged": "Import abgebrochen: die Szene ist unverändert",
    "Import into UniSim": "In UniSim importieren",
    "Import or train a trained scene first": "Zuerst eine trainierte Szene importieren oder trainieren",
    "Import the drive of a scenario with all its edits": "Die Fahrt eines Szenarios mit allen Änderungen importieren",
    "Import the scenario, trained scene, log or rig preset that a dropped file belongs to": (
        "Szenario, trainierte Szene, Log oder Rig-Preset importieren, wozu eine abgelegte Datei gehört"
    ),
    "Import the vehicle, sensors and actors of a recorded drive as animated objects": (
        "Fahrzeug, Sensoren und Akteure einer aufgezeichneten Fahrt als animierte Objekte importieren"
    ),
    "Imported {log}: {parts}; {what}": "{log} importiert: {parts}; {what}",
    "Importing {what}: {done} of {total} (Esc to cancel)": "Importiere {what}: {done} von {total} (Esc bricht ab)",
    "In Recorded Views": "In aufgezeichneten Ansichten",
    "In place": "An Ort und Stelle",
    "In seconds of the log": "In Sekunden des Logs",
    "In the world's axes": "In den Achsen der Welt",
    "Insert": "Einfügen",
    "Insert Actor": "Akteur einfügen",
    "Insert an actor of the drive or of a trained scene at the 3D cursor": (
        "Einen Akteur der Fahrt oder einer trainierten Szene am 3D-Cursor einfügen"
    ),
    "Insert from Another Scene": "Aus anderer Szene einfügen",
    "Inserted": "Eingefügt",
    "Instance": "Instanz",
    "Instead of the sensors on the vehicle: recorded ones are hidden and can be restored, others go": (
        "Statt der Sensoren am Fahrzeug: aufgezeichnete werden ausgeblendet und lassen sich wiederherstellen, andere "
        "werden gelöscht"
    ),
    "Intensity": "Intensität",
    "It changes where it is ahead of the ego vehicle by this distance or more": (
        "Er wechselt, wo er dem Ego-Fahrzeug um diesen Abstand oder mehr voraus ist"
    ),
    "It changes where it is ahead of the ego vehicle by this time or less": (
        "Er wechselt, wo er dem Ego-Fahrzeug um diese Zeit oder weniger voraus ist"
    ),
    "Item": "Objekt",
    "Its speed after the change, compared with the ego vehicle": (
        "Seine Geschwindigkeit nach dem Wechsel, verglichen mit dem Ego-Fahrzeug"
    ),
    "JSON pointer of the field of the scenario that the values go into": (
        "JSON-Pointer des Feldes des Szenarios, in das die Werte kommen"
    ),
    "Jump to Its Time": "Zu seiner Zeit springen",
    "Keep the current location, as part of the vehicle from this frame on": (
        "Die aktuelle Position behalten, ab diesem Bild als Teil des Fahrzeugs"
    ),
    "Kept as imported: {names}": "Wie importiert behalten: {names}",
    "Keyframes rotate this sensor: edit them in the Graph Editor, or delete them": (
        "Schlüsselbilder drehen diesen Sensor: sie im Graph-Editor bearbeiten oder löschen"
    ),
    "Keys": "Schlüssel",
    "Kind": "Art",
    "Kind of time change": "Art der zeitlichen Änderung",
    "Lane width": "Spurbreite",
    "Largest acceleration": "Größte Beschleunigung",
    "Largest acceleration along its path": "Größte Beschleunigung längs seines Pfads",
    "Largest acceleration to the side": "Größte Beschleunigung zur Seite",
    (
        "Largest plausible curvature of a vehicle's path; 0.2 1/m is a radius of 5 m, about the smallest that a small car "
        "can drive"
    ): (
        "Größte plausible Krümmung des Pfads eines Fahrzeugs; 0,2 1/m ist ein Radius von 5 m, etwa der kleinste, den ein "
        "Kleinwagen fahren kann"
    ),
    "Largest plausible lateral acceleration of a vehicle; ordinary driving stays below about 0.4 g": (
        "Größte plausible Querbeschleunigung eines Fahrzeugs; gewöhnliches Fahren bleibt unter etwa 0,4 g"
    ),
    (
        "Largest plausible longitudinal acceleration of a vehicle, speeding up or braking; brakes of passenger cars have "
        "to give 6.43 m/s² (UN Regulation 13-H)"
    ): (
        "Größte plausible Längsbeschleunigung eines Fahrzeugs beim Beschleunigen oder Bremsen; Bremsen von Personenwagen "
        "müssen 6,43 m/s² leisten (UN-Regelung 13-H)"
    ),
    "Largest speed of an attack": "Größte Geschwindigkeit eines Angriffs",
    "Last": "Letzter",
    "Last value": "Letzter Wert",
    "Later": "Später",
    "Lateral": "Quer",
    "Least TTC": "Kleinste TTC",
    "Left": "Links",
    "Left of the source with a gap of 0.6 m": "Links der Quelle mit 0,6 m Abstand",
    "Let the actor move as all others do in simulations": "Den Akteur in Simulationen wie alle anderen bewegen",
    "Let the driver drive through the scenario, with sensors that answer and actors that react, in the background": (
        "Den Fahrer durch das Szenario fahren lassen, mit Sensoren, die antworten, und Akteuren, die reagieren, "
        "im Hintergrund"
    ),
    "Let the driver of the panel Simulate drive through each variant, in place of rendering it": (
        "Den Fahrer des Panels Simulieren durch jede Variante fahren lassen, statt sie zu rendern"
    ),
    "Let the edit count again; an edit of the same object that cannot stand beside it is muted": (
        "Die Änderung wieder gelten lassen; eine Änderung desselben Objekts, die nicht neben ihr bestehen kann, wird "
        "stummgeschaltet"
    ),
    "LiDAR": "LiDAR",
    "LiDAR Points": "LiDAR-Punkte",
    "LiDAR of the vehicle": "LiDAR des Fahrzeugs",
    "LiDAR on the Vehicle": "LiDAR am Fahrzeug",
    "LiDAR points": "LiDAR-Punkte",
    "Library written to {path} (actors: {count})": "Bibliothek nach {path} geschrieben (Akteure: {count})",
    "Limit duration": "Dauer begrenzen",
    "Limits of vehicles": "Grenzwerte von Fahrzeugen",
    "List all actors again": "Wieder alle Akteure listen",
    "List implausible edits: overlaps, sideways or too fast cars, actors off the ground, far or unseen camera views": (
        "Unplausible Änderungen auflisten: Überlappungen, quer oder zu schnell fahrende Autos, Akteure nicht am Boden, "
        "entfernte oder nie aufgezeichnete Ansichten"
    ),
    "Local date and time of the check": "Ortszeit und Datum der Prüfung",
    "Location": "Position",
    "Location of the copies": "Ort der Kopien",
    "Log": "Log",
    "Long steps, and fewer pixels traced individually": "Lange Schritte, und weniger Pixel einzeln verfolgt",
    "Longest Axis": "Längste Achse",
    "Look Through": "Hindurchblicken",
    "Look Through Camera": "Durch Kamera blicken",
    "Look through this camera and use its image size": "Durch diese Kamera blicken und ihre Bildgröße verwenden",
    "Make Actor Library": "Akteurbibliothek erstellen",
    "Make a camera or a LiDAR active first": "Zuerst eine Kamera oder ein LiDAR aktiv machen",
    "Make a moving actor active first: use G for actors that do not move": (
        "Zuerst einen bewegten Akteur aktiv machen: für unbewegte Akteure G verwenden"
    ),
    "Make an actor active first: click it": "Zuerst einen Akteur aktiv machen: anklicken",
    "Mark Static Item": "Statisches Objekt markieren",
    "Mark a static item: the bounding box of the selected active mesh, or a new box at the 3D cursor": (
        "Ein statisches Objekt markieren: den Begrenzungsquader des ausgewählten aktiven Meshs oder einen neuen am 3D-Cursor"
    ),
    "Mark a variant in the list first": "Zuerst eine Variante in der Liste markieren",
    "Maximum range of custom beams": "Größte Reichweite eigener Strahlen",
    "Measures": "Maße",
    "Mesh": "Mesh",
    "Mesh actors keep their own appearance: select recorded actors only": (
        "Mesh-Akteure behalten ihr Aussehen: nur aufgezeichnete Akteure auswählen"
    ),
    "Mesh actors: {count}": "Mesh-Akteure: {count}",
    "Mesh inserted": "Als Mesh eingefügt",
    "Mesh of the body of the ego vehicle, which the sensors of the vehicle do not see": (
        "Mesh der Karosserie des Ego-Fahrzeugs, die die Sensoren des Fahrzeugs nicht sehen"
    ),
    "Minutes": "Minuten",
    "Mode": "Modus",
    "Model": "Modell",
    "Model configuration": "Modellkonfiguration",
    "Motion": "Bewegung",
    "Mount": "Montageort",
    "Move": "Verschieben",
    "Move the selected actors along the selected curve at a constant speed, from the current frame on": (
        "Die ausgewählten Akteure ab dem aktuellen Bild mit konstanter Geschwindigkeit entlang der ausgewählten Kurve bewegen"
    ),
    "Moved": "Verschoben",
    "Moved {by}": "Verschoben: {by}",
    "Moving objects are children of trajectories; files of earlier versions are converted": (
        "Bewegte Objekte sind Trajektorien untergeordnet; Dateien früherer Versionen werden umgewandelt"
    ),
    "Mute Edit": "Änderung stummschalten",
    "Mute or unmute the edit; a muted edit is kept in the file and ignored in images, sweeps and scenarios": (
        "Die Änderung stummschalten oder wieder aktivieren; eine stummgeschaltete bleibt in der Datei und wird in Bildern, "
        "Sweeps und Szenarien ignoriert"
    ),
    "Mute the edit: it stays in the file and counts in no image, sweep or scenario": (
        "Die Änderung stummschalten: sie bleibt in der Datei und gilt in keinem Bild, Sweep oder Szenario"
    ),
    "Muted: it does not count": "Stummgeschaltet: sie gilt nicht",
    "Muted: {edit}": "Stummgeschaltet: {edit}",
    "Muted: {what} ({who})": "Stummgeschaltet: {what} ({who})",
    "NCAP stars": "NCAP-Sterne",
    "NVIDIA GPU": "NVIDIA-GPU",
    "Name": "Name",
    "Name of the object when it was imported; copies have another name": (
        "Name des Objekts beim Import; Kopien haben einen anderen Namen"
    ),
    "Name the driver first: module:function, or its address": (
        "Zuerst den Fahrer nennen: Modul:Funktion, oder seine Adresse"
    ),
    "Nearest to the ego vehicle first, absent actors last": (
        "Dem Ego-Fahrzeug nächste zuerst, abwesende Akteure zuletzt"
    ),
    "Negative: to the right": "Negativ: nach rechts",
    "Never": "Nie",
    "New": "Neu",
    "New Variant": "Neue Variante",
    "New trajectory, up to {length} away": "Neue Trajektorie, bis zu {length} entfernt",
    "Next lane, left": "Nächste Spur, links",
    "Next lane, right": "Nächste Spur, rechts",
    "No active actor": "Kein aktiver Akteur",
    "No actor has a model of its own": "Kein Akteur hat ein eigenes Modell",
    "No actor is listed: clear the filter": "Kein Akteur ist gelistet: den Filter zurücksetzen",
    "No actor: clear the filter": "Kein Akteur: den Filter zurücksetzen",
    "No drive imported": "Keine Fahrt importiert",
    "No mesh is the ego vehicle's body: Use as Ego Body makes one": (
        "Kein Mesh ist die Karosserie des Ego-Fahrzeugs: „Als Ego-Karosserie verwenden“ macht eines dazu"
    ),
    "No presets of your own yet": "Noch keine eigenen Presets",
    "No rollout yet": "Noch kein Rollout",
    "No task": "Keine Aufgabe",
    "No task is running": "Es läuft keine Aufgabe",
    "No warnings": "Keine Warnungen",
    "None": "Keine",
    "None: everything is as recorded": "Keine: alles ist wie aufgezeichnet",
    "Normal": "Normale",
    "Not checked yet": "Noch nicht geprüft",
    "Not part of a drive": "Nicht Teil einer Fahrt",
    "Not scored yet": "Noch nicht bewertet",
    "Nothing is shifted: all amounts are 0": "Nichts wird verschoben: alle Beträge sind 0",
    "Numbers from the first to the last, evenly spaced": (
        "Zahlen vom ersten bis zum letzten Wert, in gleichen Abständen"
    ),
    "Numbers or ids, separated by commas: 0, 2.5, car-01": "Zahlen oder Ids, durch Kommas getrennt: 0, 2.5, car-01",
    "Object name for which that identifier is valid": "Objektname, für den dieser Bezeichner gilt",
    "Objects deleted: {count}": "Objekte gelöscht: {count}",
    "Of all random numbers: starts and actors": "Aller Zufallszahlen: Starts und Akteure",
    "Off the log": "Neben dem Log",
    "Off the road": "Neben der Straße",
    "Off the vehicle": "Nicht am Fahrzeug",
    "Offset": "Versatz",
    "Offset from the trajectory before the first keyframe": "Versatz zur Trajektorie vor dem ersten Schlüsselbild",
    "Offset of the recorded LiDAR points to the left of the vehicle, for comparison with simulated points": (
        "Versatz der aufgezeichneten LiDAR-Punkte nach links vom Fahrzeug, zum Vergleich mit simulierten Punkten"
    ),
    "Offset subtracted from the coordinates of the log, three float64 values as JSON": (
        "Versatz, der von den Koordinaten des Logs abgezogen wird, drei float64-Werte als JSON"
    ),
    "On the vehicle": "Am Fahrzeug",
    "One colour per actor; recorded points are coloured by class": (
        "Eine Farbe je Akteur; aufgezeichnete Punkte werden nach Klasse gefärbt"
    ),
    "One lane to the left": "Eine Spur nach links",
    "One lane to the right": "Eine Spur nach rechts",
    "Only actors that are present at the current frame": "Nur Akteure, die im aktuellen Bild anwesend sind",
    "Only actors that were added, removed or edited": "Nur Akteure, die hinzugefügt, entfernt oder geändert wurden",
    "Only actors within this distance of the ego vehicle at the current frame; 0 for any distance": (
        "Nur Akteure, die im aktuellen Bild höchstens so weit vom Ego-Fahrzeug entfernt sind; 0 für jeden Abstand"
    ),
    "Only in {name}: {who}": "Nur in {name}: {who}",
    "Only the active camera of the scene": "Nur die aktive Kamera der Szene",
    "Opacity": "Deckkraft",
    "Opacity of everything nearer than the background model": (
        "Deckkraft von allem, was näher als das Hintergrundmodell ist"
    ),
    "Opacity pass": "Deckkraft-Pass",
    "Open Folder": "Ordner öffnen",
    "Open Presets Folder": "Preset-Ordner öffnen",
    "Open Report": "Bericht öffnen",
    "Open Rollout": "Rollout öffnen",
    "Open a rollout first: this scene is none": "Zuerst einen Rollout öffnen: diese Szene ist keiner",
    "Open a rollout's folder: the drive as driven, its collisions as markers, the plans of its driver": (
        "Den Ordner eines Rollouts öffnen: die Fahrt wie gefahren, ihre Kollisionen als Markierungen, die Pläne "
        "ihres Fahrers"
    ),
    "Open the folder of your own rig presets: files that colleagues gave you go there": (
        "Den Ordner der eigenen Rig-Presets öffnen: dorthin kommen Dateien von Kollegen"
    ),
    "Open the output folder in the system's file browser": "Den Ausgabeordner im Dateibrowser des Systems öffnen",
    "Open the report of the batch in the browser: its variants with images, scores, and filters over parameters": (
        "Den Bericht des Stapels im Browser öffnen: seine Varianten mit Bildern, Bewertungen und Filtern über Parameter"
    ),
    "Opening the drive (Esc to cancel)": "Fahrt wird geöffnet (Esc bricht ab)",
    "Order of the list": "Reihenfolge der Liste",
    "Others": "Andere",
    "Ouster OS1-128: 128 even beams over 45 degrees, 1024 columns": (
        "Ouster OS1-128: 128 gleichmäßige Strahlen über 45 Grad, 1024 Spalten"
    ),
    "Ouster OS1-64: 64 even beams over 45 degrees, 1024 columns": (
        "Ouster OS1-64: 64 gleichmäßige Strahlen über 45 Grad, 1024 Spalten"
    ),
    "Output": "Ausgabe",
    "Output folder of sequences": "Ausgabeordner von Sequenzen",
    "Own": "Eigene",
    "Own: none yet": "Eigene: noch keine",
    "Page": "Seite",
    "Page (of {count})": "Seite (von {count})",
    "Page of {count}, from 0": "Seite von {count}, ab 0",
    "Page that is shown; 0 for all at once": "Seite, die gezeigt wird; 0 für alle zugleich",
    "Paper": "Paper",
    "Part of a name or a class": "Teil eines Namens oder einer Klasse",
    "Passes": "Passes",
    "Passes and Effects": "Passes und Effekte",
    "Passes that a sequence contains in addition to colours": "Passes, die eine Sequenz außer den Farben enthält",
    "Path of the .blend file, in a folder listed in Preferences > File Paths > Asset Libraries": (
        "Pfad der .blend-Datei, in einem Ordner aus Einstellungen > Dateipfade > Asset-Bibliotheken"
    ),
    "Pedestrians": "Fußgänger",
    "People": "Personen",
    "Pitch": "Nicken",
    "Pixels that no recorded data supports": "Pixel, die keine aufgezeichneten Daten stützen",
    "Place": "Ort",
    "Place the selected actors and static items on the ground below them, at the current frame": (
        "Die ausgewählten Akteure und statischen Objekte im aktuellen Bild auf den Boden unter ihnen setzen"
    ),
    "Plans": "Pläne",
    "Play Result": "Ergebnis abspielen",
    "Play the rendered images of a camera in Blender's animation player": (
        "Die gerenderten Bilder einer Kamera in Blenders Animationsplayer abspielen"
    ),
    "Pointing ahead, on the height of the vehicle's origin, its rear 1 m behind that": (
        "Nach vorn zeigend, auf der Höhe des Fahrzeugursprungs, das Heck 1 m dahinter"
    ),
    "Points along": "Zeigt entlang",
    "Position in the frame of the vehicle": "Position im Koordinatensystem des Fahrzeugs",
    "Presence Timeline": "Anwesenheitsleiste",
    "Present": "Anwesend",
    "Present Now": "Jetzt anwesend",
    "Present from {start:.1f} to {end:.1f} s": "Anwesend von {start:.1f} bis {end:.1f} s",
    "Preset": "Preset",
    "Preview {number} of {count}": "Vorschau {number} von {count}",
    "Processes": "Prozesse",
    "Processes of this machine, of one thread each": "Prozesse dieses Rechners mit je einem Thread",
    "Processes, or workers of Ray; 0 for one a core": "Prozesse oder Worker von Ray; 0 für einen je Kern",
    "Progress": "Fortschritt",
    "Put a rig preset's cameras and LiDARs on the vehicle": (
        "Kameras und LiDARs eines Rig-Presets am Fahrzeug anbringen"
    ),
    "Python Function": "Python-Funktion",
    "Python interpreter with torch, for training and GPU rendering; Blender's own renders on the CPU if empty": (
        "Python-Interpreter mit torch, für Training und Rendern auf der GPU; leer rendert Blenders eigener auf der CPU"
    ),
    "Python {version}, kernels: {kernels}": "Python {version}, Kernel: {kernels}",
    "Quality": "Qualität",
    "Random Starts": "Zufällige Starts",
    "Range": "Reichweite",
    "Ray": "Ray",
    "Ray cluster: ray://HOST:PORT; empty for this machine": "Ray-Cluster: ray://HOST:PORT; leer für diesen Rechner",
    "Reading the edits…": "Änderungen werden gelesen …",
    "Reading the scene": "Szene wird gelesen",
    "Reading {scene}: {done} of {total} (Esc to cancel)": "{scene} wird gelesen: {done} von {total} (Esc bricht ab)",
    "Recorded": "Aufgezeichnet",
    "Recorded Drive": "Aufgezeichnete Fahrt",
    "Recorded Offset": "Versatz der aufgezeichneten",
    "Recorded images warped over surfels, without training": (
        "Aufgezeichnete Bilder, über Surfels verzogen, ohne Training"
    ),
    "Recorded points": "Aufgezeichnete Punkte",
    "Recorded points are yellow, simulated points blue": "Aufgezeichnete Punkte sind gelb, simulierte blau",
    "Reference": "Referenz",
    "Release Ego Body": "Ego-Karosserie freigeben",
    "Release Mesh Actor": "Mesh-Akteur freigeben",
    "Remove Parameter": "Parameter entfernen",
    "Remove Rig Preset": "Rig-Preset entfernen",
    "Remove the marks of the selected static items; the scene itself stays unchanged": (
        "Die Markierungen der ausgewählten statischen Objekte entfernen; die Szene selbst bleibt unverändert"
    ),
    "Remove this parameter": "Diesen Parameter entfernen",
    "Removed": "Entfernt",
    "Removed {path}": "{path} entfernt",
    "Rename": "Umbenennen",
    "Rename Variant": "Variante umbenennen",
    "Rename the shown variant": "Die gezeigte Variante umbenennen",
    "Render": "Rendern",
    "Render Sequence": "Sequenz rendern",
    "Render Sequence of Sensors": "Sequenz der Sensoren rendern",
    "Render Variants": "Varianten rendern",
    "Render and export the frame range of the scene in place of the frames or times that the imported scenario states": (
        "Den Bildbereich der Szene rendern und exportieren statt der Bilder oder Zeitpunkte, die das importierte Szenario nennt"
    ),
    "Render it with the selected variants": "Mit den ausgewählten Varianten rendern",
    "Render on a GPU with CUDA": "Auf einer GPU mit CUDA rendern",
    "Render on a GPU with Metal": "Auf einer GPU mit Metal rendern",
    "Render on the CPU": "Auf der CPU rendern",
    "Render the marked variants one after another, each into its own folder in the output folder; finished frames are kept": (
        "Die markierten Varianten nacheinander rendern, jede in ihren eigenen Ordner im Ausgabeordner; fertige Bilder "
        "bleiben erhalten"
    ),
    "Render the marked variants with all values of the parameters, or drive through them, in the background": (
        "Die markierten Varianten mit allen Werten der Parameter im Hintergrund rendern oder durchfahren"
    ),
    "Render the sensors over the frame range into the output folder, in the background; finished frames are kept": (
        "Die Sensoren über den Bildbereich im Hintergrund in den Ausgabeordner rendern; fertige Bilder bleiben erhalten"
    ),
    "Rendered": "Gerendert",
    "Renderer": "Renderer",
    "Renderer's Python": "Python des Renderers",
    "Rendering": "Rendert",
    "Rendering runs on the CPU; training and GPU rendering need an interpreter with torch, named above": (
        "Gerendert wird auf der CPU; Training und Rendern auf der GPU brauchen einen Interpreter mit torch, oben anzugeben"
    ),
    "Renders with {path}": "Rendert mit {path}",
    "Replace": "Ersetzen",
    "Replace Appearance": "Aussehen ersetzen",
    "Replace the appearance and the box of the selected actors by those of another actor, on the same trajectory": (
        "Aussehen und Quader der ausgewählten Akteure durch die eines anderen ersetzen, auf derselben Trajektorie"
    ),
    "Replace the preset of this name": "Das Preset dieses Namens ersetzen",
    "Replay": "Abspielen",
    "Replay, Then Follow": "Abspielen, dann folgen",
    "Restore Recorded Sensors": "Aufgezeichnete Sensoren wiederherstellen",
    "Restored {names}": "Wiederhergestellt: {names}",
    "Retime": "Zeit ändern",
    "Retime Actor": "Zeit des Akteurs ändern",
    "Retimed: up to {time} earlier": "Zeitlich verschoben: bis zu {time} früher",
    "Retimed: up to {time} later": "Zeitlich verschoben: bis zu {time} später",
    "Retimed: {before} earlier to {after} later": "Zeitlich verschoben: {before} früher bis {after} später",
    "Retimed: {time} earlier": "Zeitlich verschoben: {time} früher",
    "Retimed: {time} later": "Zeitlich verschoben: {time} später",
    "Returns of a sweep": "Rückstrahlungen eines Sweeps",
    "Revert Edit": "Änderung zurücknehmen",
    "Revert the edit: the object returns to its imported state, a copied or inserted object is deleted": (
        "Die Änderung zurücknehmen: das Objekt kehrt in seinen importierten Zustand zurück, ein kopiertes oder eingefügtes "
        "wird gelöscht"
    ),
    "Reverted: {what} ({who})": "Zurückgenommen: {what} ({who})",
    "Rig Presets": "Rig-Presets",
    "Right of the source with a gap of 0.6 m": "Rechts der Quelle mit 0,6 m Abstand",
    "Road": "Straße",
    "Rotation relative to the trajectory before the first keyframe": (
        "Drehung relativ zur Trajektorie vor dem ersten Schlüsselbild"
    ),
    "Rotation to the left in degrees": "Drehung nach links in Grad",
    "Rotation upwards in degrees": "Drehung nach oben in Grad",
    "Rows": "Zeilen",
    "Run on": "Ausführen mit",
    "Same for Selected": "Gleich für Ausgewählte",
    "Sampling": "Abtastung",
    "Sampling density along rays": "Abtastdichte entlang der Strahlen",
    "Save Rig Preset": "Rig-Preset speichern",
    "Save the .blend first, or choose a folder for rollouts that does not depend on it": (
        "Zuerst die .blend speichern, oder einen Ordner für Rollouts wählen, der nicht von ihr abhängt"
    ),
    "Save the .blend first, or choose a folder that does not depend on it": (
        "Zuerst die .blend-Datei speichern oder einen Ordner wählen, der nicht von ihr abhängt"
    ),
    "Save the sensors on the vehicle as a rig preset of your own, a file that colleagues can put into their presets folder": (
        "Die Sensoren am Fahrzeug als eigenes Rig-Preset speichern, eine Datei, die Kollegen in ihren Preset-Ordner legen können"
    ),
    "Scale that the location accounts for; zero where none was noted": (
        "Skalierung, die in der Position berücksichtigt ist; null, wo keine vermerkt wurde"
    ),
    "Scaled by {factors}": "Skaliert mit {factors}",
    "Scenario written to {path} (edits: {count})": "Szenario nach {path} geschrieben (Änderungen: {count})",
    "Scenarios written to {folder}: {count}": "Szenarien nach {folder} geschrieben: {count}",
    "Scenarios: {count}": "Szenarien: {count}",
    "Scene": "Szene",
    "Scores": "Bewertung",
    "Scripted": "Nach Skript",
    "Scroll Presence Timeline": "Anwesenheitsleiste rollen",
    "Scroll the presence timeline under the mouse": "Die Anwesenheitsleiste unter der Maus rollen",
    "Searching…": "Suche …",
    "Seconds": "Sekunden",
    "Seconds of the drive to go to; below 0: as the list's settings have it": (
        "Sekunden der Fahrt, zu denen gegangen wird; unter 0: wie in den Einstellungen der Liste"
    ),
    "Seconds of the log": "Sekunden des Logs",
    "Seconds, speed in m/s, metres to the left of the path; '-' for none: 0 5, 2 8, 3 - 1.5": (
        "Sekunden, Geschwindigkeit in m/s, Meter links vom Pfad; '-' für keine: 0 5, 2 8, 3 - 1.5"
    ),
    "Seed": "Startwert",
    "Sees body": "Sieht Karosserie",
    "Sees ego body": "Sieht Ego-Karosserie",
    "Select Actor": "Akteur auswählen",
    "Select Listed": "Gelistete auswählen",
    "Select a LiDAR first": "Zuerst ein LiDAR auswählen",
    "Select a mesh actor first": "Zuerst einen Mesh-Akteur auswählen",
    "Select a mesh object that is not part of the drive yet": (
        "Ein Mesh-Objekt auswählen, das noch nicht Teil der Fahrt ist"
    ),
    "Select a static item first": "Zuerst ein statisches Objekt auswählen",
    "Select all actors that are listed and visible in the view": (
        "Alle Akteure auswählen, die gelistet und in der Ansicht sichtbar sind"
    ),
    "Select an actor and make it active": "Einen Akteur auswählen und aktiv machen",
    "Select an actor first": "Zuerst einen Akteur auswählen",
    "Select an actor or a static item first": "Zuerst einen Akteur oder ein statisches Objekt auswählen",
    "Select further actors: the active one has this model already": (
        "Weitere Akteure auswählen: der aktive hat dieses Modell schon"
    ),
    "Select one curve in addition to the actors (Add > Curve)": (
        "Zu den Akteuren eine Kurve auswählen (Hinzufügen > Kurve)"
    ),
    "Select the object and go to a frame at which the edit shows": (
        "Das Objekt auswählen und zu einem Bild gehen, in dem die Änderung zu sehen ist"
    ),
    "Selected Sensors": "Ausgewählte Sensoren",
    "Sensor": "Sensor",
    "Sensors": "Sensoren",
    "Sensors see the mesh of the object and of its children": "Sensoren sehen das Mesh des Objekts und seiner Kinder",
    "Sensors that a sequence renders": "Sensoren, die eine Sequenz rendert",
    "Set an output folder first: UniSim > Output > Folder": (
        "Zuerst einen Ausgabeordner angeben: UniSim > Ausgabe > Ordner"
    ),
    "Shift": "Verschieben",
    "Shift Actor": "Akteur verschieben",
    "Shift Ego Lane": "Ego-Spur verschieben",
    "Shift Lane": "Spur verschieben",
    "Shift ego lane: {shift}": "Ego-Spur verschieben: {shift}",
    "Shift in time in seconds of the log, including when the actor is present; negative values shift earlier": (
        "Zeitliche Verschiebung in Sekunden des Logs, samt der Anwesenheit des Akteurs; negative Werte verschieben auf früher"
    ),
    "Shift the selected actors sideways, along the path of their trajectory and in time, alike at every time": (
        "Die ausgewählten Akteure seitwärts, entlang des Pfads ihrer Trajektorie und in der Zeit verschieben, zu jeder "
        "Zeit gleich"
    ),
    "Shift to the left of the actor; negative values shift to the right": (
        "Verschiebung nach links vom Akteur; negative Werte verschieben nach rechts"
    ),
    "Show": "Anzeigen",
    "Show Colours as Recorded": "Farben wie aufgezeichnet",
    "Show LiDAR Points": "LiDAR-Punkte anzeigen",
    "Show UniSim's handles also in a view through a camera of the drive, where they lie over the image": (
        "UniSims Griffe auch in einer Ansicht durch eine Kamera der Fahrt zeigen, wo sie über dem Bild liegen"
    ),
    "Show Variant": "Variante zeigen",
    "Show cameras, LiDARs and the axes of the ego vehicle in views that do not look through a sensor": (
        "Kameras, LiDARs und die Achsen des Ego-Fahrzeugs in Ansichten zeigen, die nicht durch einen Sensor blicken"
    ),
    "Show colours as recorded: view transform Standard, look None, exposure 0, gamma 1": (
        "Farben wie aufgezeichnet zeigen: Ansichtstransformation Standard, Look None, Belichtung 0, Gamma 1"
    ),
    "Show only what the recording observed, without what lies in front of it, in views that do not look through a camera": (
        "In Ansichten, die nicht durch eine Kamera blicken, nur zeigen, was die Aufzeichnung beobachtet hat, ohne was davor liegt"
    ),
    "Show or Hide Sensor": "Sensor ein- oder ausblenden",
    "Show or hide this sensor; a hidden sensor is not part of views, sequences and scenarios": (
        "Diesen Sensor ein- oder ausblenden; ein ausgeblendeter ist nicht Teil von Ansichten, Sequenzen und Szenarien"
    ),
    "Show recorded LiDAR points, simulated LiDAR points, or both": (
        "Aufgezeichnete LiDAR-Punkte, simulierte oder beide anzeigen"
    ),
    "Show recorded points": "Aufgezeichnete Punkte anzeigen",
    "Show recorded sensors again that a rig preset has hidden, and make those anew that were deleted": (
        "Aufgezeichnete Sensoren wieder zeigen, die ein Rig-Preset ausgeblendet hat, und gelöschte neu erstellen"
    ),
    "Show simulated LiDAR points of the current frame": "Simulierte LiDAR-Punkte des aktuellen Bildes anzeigen",
    "Show simulated points": "Simulierte Punkte anzeigen",
    "Show the recorded LiDAR points of the current frame": "Aufgezeichnete LiDAR-Punkte des aktuellen Bildes anzeigen",
    "Show this variant, at the same frame": "Diese Variante im selben Bild zeigen",
    "Sideways": "Seitwärts",
    "Similar pixels are traced together": "Ähnliche Pixel werden gemeinsam verfolgt",
    "Simulate": "Simulieren",
    "Simulate for some time; else to the last frame of the drive": (
        "Eine Zeitlang simulieren; sonst bis zum letzten Bild der Fahrt"
    ),
    "Simulate on from the current frame: as driven until then, with the edits of this scene from then on": (
        "Ab dem aktuellen Bild weiter simulieren: bis dahin wie gefahren, von da an mit den Änderungen dieser Szene"
    ),
    "Simulated": "Simuliert",
    "Simulated points": "Simulierte Punkte",
    "Simulated time": "Simulierte Zeit",
    "Single": "Einzelne",
    "Size": "Größe",
    "Size of the new box": "Größe des neuen Quaders",
    "Slow: four times the number of samples of the scene": "Langsam: viermal so viele Abtastpunkte wie die Szene",
    "Small": "Klein",
    "Snap to Ground": "Auf den Boden setzen",
    "So far off its recorded place the ego vehicle has left its log": (
        "So weit neben seinem aufgezeichneten Ort hat das Ego-Fahrzeug sein Log verlassen"
    ),
    "So many of the best drives, of which it draws one": "So viele der besten Fahrten, aus denen er eine zieht",
    "So many values": "So viele Werte",
    "So much later an answer of the driver takes effect: a multiple of the step": (
        "So viel später wirkt eine Antwort des Fahrers: ein Vielfaches des Schritts"
    ),
    "Soft shadows under copied and inserted actors": "Weiche Schatten unter kopierten und eingefügten Akteuren",
    "Sort by": "Sortieren nach",
    "Speed": "Geschwindigkeit",
    "Speed Graph": "Geschwindigkeitskurve",
    "Speed along the curve": "Geschwindigkeit entlang der Kurve",
    "Speed difference": "Geschwindigkeitsdifferenz",
    "Split": "Teilen",
    "Stands for {duration}": "Steht für {duration}",
    "Stands still": "Steht still",
    "Start": "Start",
    "Start at": "Starten bei",
    "Start at a time of the drive; else at its first frame": (
        "Zu einer Zeit der Fahrt starten; sonst bei ihrem ersten Bild"
    ),
    "Start time, in seconds of the log": "Startzeit, in Sekunden des Logs",
    "State": "Zustand",
    "Static Items": "Statische Objekte",
    "Static item": "Statisches Objekt",
    "Static items": "Statische Objekte",
    "Step": "Schritt",
    "Stop and go": "Halten und weiterfahren",
    "Stop at the current frame, then continue": "Im aktuellen Bild halten, dann weiterfahren",
    "Stop the background task; finished frames are kept, and starting it again resumes": (
        "Die Hintergrundaufgabe anhalten; fertige Bilder bleiben erhalten, ein neuer Start setzt fort"
    ),
    "Stopped at {progress}; start it again to resume": "Angehalten bei {progress}; erneut starten setzt fort",
    "Stopping: {progress}": "Hält an: {progress}",
    "Straight on at the speed that it starts with": "Geradeaus mit der Geschwindigkeit, mit der er startet",
    "Stretch": "Strecken",
    "Submit Batch": "Stapel starten",
    "Surface normals in world space": "Oberflächennormalen im Weltkoordinatensystem",
    "Surfels": "Surfels",
    "Surfels that the log's sweeps give, without training": "Surfels, die die Sweeps des Logs ergeben, ohne Training",
    "Switch to Object Mode first (Tab)": "Zuerst in den Objektmodus wechseln (Tab)",
    "The ego vehicle starts turned by up to so many degrees": (
        "Um so viel Grad startet das Ego-Fahrzeug höchstens gedreht"
    ),
    "The ego vehicle starts up to so far ahead or behind": (
        "So weit startet das Ego-Fahrzeug höchstens weiter vorn oder hinten"
    ),
    "The ego vehicle starts up to so far to the left or right": (
        "So weit startet das Ego-Fahrzeug höchstens weiter links oder rechts"
    ),
    "The ego vehicle starts up to so much faster or slower": (
        "So viel schneller oder langsamer startet das Ego-Fahrzeug höchstens"
    ),
    "TTC {seconds:.1f} s: {name}": "TTC {seconds:.1f} s: {name}",
    "Test Renderer": "Renderer testen",
    "The edits cannot be read: {fault}": "Die Änderungen lassen sich nicht lesen: {fault}",
    "The ego vehicle was deleted: the recorded image of {camera} is not shown": (
        "Das Ego-Fahrzeug wurde gelöscht: das aufgezeichnete Bild von {camera} wird nicht gezeigt"
    ),
    "The filter is above the list": "Der Filter ist über der Liste",
    "The frame range is what is rendered already": "Der Bildbereich wird bereits gerendert",
    "The log ends at {time}": "Das Log endet bei {time}",
    "The log is not at hand: there are no recorded images": (
        "Das Log ist nicht verfügbar: es gibt keine aufgezeichneten Bilder"
    ),
    "The model of all actors that have none of their own": "Das Modell aller Akteure, die kein eigenes haben",
    "The object points along world -X": "Das Objekt zeigt entlang -X der Welt",
    "The object points along world -Y": "Das Objekt zeigt entlang -Y der Welt",
    "The object points along world X": "Das Objekt zeigt entlang X der Welt",
    "The object points along world Y": "Das Objekt zeigt entlang Y der Welt",
    "The output folder does not exist yet: render first": "Der Ausgabeordner existiert noch nicht: zuerst rendern",
    "The output folder has no camera images yet: render a sequence first": (
        "Der Ausgabeordner enthält noch keine Kamerabilder: zuerst eine Sequenz rendern"
    ),
    "The procedural street of the log, as it is": "Die prozedurale Straße des Logs, wie sie ist",
    "The recorded and the rendered image by turns, four times a second": (
        "Das aufgezeichnete und das gerenderte Bild abwechselnd, viermal in der Sekunde"
    ),
    "The recorded image alone": "Nur das aufgezeichnete Bild",
    "The recorded image left of a line, the rendered one right of it: drag the line": (
        "Das aufgezeichnete Bild links einer Linie, das gerenderte rechts davon: die Linie ziehen"
    ),
    "The recorded poses, without the dynamics of the vehicle": (
        "Die aufgezeichneten Posen, ohne die Dynamik des Fahrzeugs"
    ),
    "The rendered image alone": "Nur das gerenderte Bild",
    "The same edits": "Dieselben Änderungen",
    "The scenario has no edit and no setting of a simulation to vary": (
        "Das Szenario hat keine Änderung und keine Einstellung einer Simulation, die variiert werden könnte"
    ),
    "The selected cameras and LiDARs": "Die ausgewählten Kameras und LiDARs",
    "The sensor always sees the body of the ego vehicle, for example from a camera that follows the vehicle": (
        "Der Sensor sieht die Karosserie des Ego-Fahrzeugs immer, zum Beispiel eine Kamera, die dem Fahrzeug folgt"
    ),
    "The sensor never sees the body of the ego vehicle": "Der Sensor sieht die Karosserie des Ego-Fahrzeugs nie",
    "The sensor sees the body of the ego vehicle unless it is mounted on the vehicle": (
        "Der Sensor sieht die Karosserie des Ego-Fahrzeugs, falls er nicht am Fahrzeug montiert ist"
    ),
    "The sizes of the paper's re-implementation, for a GPU": (
        "Die Größen der Reimplementierung des Papers, für eine GPU"
    ),
    "The test failed": "Der Test ist fehlgeschlagen",
    "The trained scene; without one, surfels of the log": "Die trainierte Szene; ohne eine die Surfels des Logs",
    "There is no report in the folder of the batch yet": "Im Ordner des Stapels ist noch kein Bericht",
    "This is the only variant: revert its edits instead": (
        "Dies ist die einzige Variante: stattdessen ihre Änderungen zurücknehmen"
    ),
    "This view has no recorded image: look through a recorded camera (Numpad 0)": (
        "Diese Ansicht hat kein aufgezeichnetes Bild: durch eine aufgezeichnete Kamera blicken (Numpad 0)"
    ),
    "Time": "Zeit",
    "Time between two answers of the driver": "Zeit zwischen zwei Antworten des Fahrers",
    "Time between two decisions": "Zeit zwischen zwei Entscheidungen",
    "Time gap to the vehicle ahead": "Zeitlicher Abstand zum Vordermann",
    "Time that the change takes": "Zeit, die der Wechsel dauert",
    "Tiny": "Winzig",
    "To": "Bis",
    "Top speed": "Höchstgeschwindigkeit",
    "Train Neural Scene": "Neuronale Szene trainieren",
    "Train a neural scene on the imported log, in the background; an unfinished training in the folder is resumed": (
        "Eine neuronale Szene mit dem importierten Log im Hintergrund trainieren; ein unfertiges Training im Ordner wird "
        "fortgesetzt"
    ),
    "Trained Neural Scene (scene.json)": "Trainierte neuronale Szene (scene.json)",
    "Trained scene": "Trainierte Szene",
    "Trained scene that provides the appearance": "Trainierte Szene, aus der das Aussehen stammt",
    "Training and Assets": "Training und Assets",
    "Training time in minutes": "Trainingszeit in Minuten",
    "Trajectories": "Trajektorien",
    "Trajectory": "Trajektorie",
    "Trucks and buses": "Lastwagen und Busse",
    "Trucks, buses, construction and emergency vehicles, trailers": (
        "Lastwagen, Busse, Bau- und Einsatzfahrzeuge, Anhänger"
    ),
    "Turn the View": "Ansicht wenden",
    "Turn the active camera or LiDAR on its mount, by yaw and pitch from the vehicle's axis": (
        "Die aktive Kamera oder das aktive LiDAR auf seiner Montage drehen, um Gier- und Nickwinkel von der Achse des Fahrzeugs"
    ),
    "Turn the selected ego bodies, or all if none is selected, back into ordinary objects, which no sensor sees": (
        "Die ausgewählten Ego-Karosserien, oder alle, falls keine ausgewählt ist, wieder zu gewöhnlichen Objekten machen, "
        "die kein Sensor sieht"
    ),
    "Turn the selected mesh actors back into ordinary objects, which no sensor sees": (
        "Die ausgewählten Mesh-Akteure wieder zu gewöhnlichen Objekten machen, die kein Sensor sieht"
    ),
    "Turned": "Gedreht",
    "Turned (°)": "Gedreht (°)",
    "Two-wheelers": "Zweiräder",
    "UniSim": "UniSim",
    "UniSim Rollout (folder)": "UniSim-Rollout (Ordner)",
    "UniSim Scenario (.json)": "UniSim-Szenario (.json)",
    "UniSim training": "UniSim-Training",
    "Unmark Static Item": "Markierung des statischen Objekts entfernen",
    "Unmuted: {what} ({who})": "Wieder aktiviert: {what} ({who})",
    "Unsupported": "Nicht gestützt",
    "Unsupported: nothing recorded shows this": "Nicht gestützt: nichts Aufgezeichnetes zeigt dies",
    "Use Frame Range": "Bildbereich verwenden",
    "Use Mesh as Actor": "Mesh als Akteur verwenden",
    "Use as Ego Body": "Als Ego-Karosserie verwenden",
    "Use the selected mesh objects and their children as actors, which cameras and LiDARs see": (
        "Die ausgewählten Mesh-Objekte und ihre Kinder als Akteure verwenden, die Kameras und LiDARs sehen"
    ),
    "Use the selected mesh objects and their children as the body of the ego vehicle, which sensors on it do not see": (
        "Die ausgewählten Mesh-Objekte und ihre Kinder als Karosserie des Ego-Fahrzeugs verwenden, die Sensoren daran nicht sehen"
    ),
    "Values": "Werte",
    "Variants": "Varianten",
    "Vehicle that recorded the drive": "Fahrzeug, das die Fahrt aufgezeichnet hat",
    "Velodyne HDL-32E: 32 beams 4/3 degrees apart": "Velodyne HDL-32E: 32 Strahlen im Abstand von 4/3 Grad",
    "Velodyne HDL-64E: 32 beams a third of a degree apart from 2 degrees down, then 32 half a degree apart": (
        "Velodyne HDL-64E: 32 Strahlen im Abstand von einem Drittel Grad ab 2 Grad nach unten, dann 32 im Abstand von "
        "einem halben Grad"
    ),
    "Velodyne VLP-16: 16 beams 2 degrees apart": "Velodyne VLP-16: 16 Strahlen im Abstand von 2 Grad",
    "Velodyne VLP-32C (Ultra Puck): 32 beams, dense about the horizon": (
        "Velodyne VLP-32C (Ultra Puck): 32 Strahlen, dicht um den Horizont"
    ),
    "Warning": "Warnung",
    "Warnings": "Warnungen",
    "Warnings: {count}": "Warnungen: {count}",
    "Warped Images": "Verzogene Bilder",
    "What comes after is {shift}": "Was danach kommt, ist {shift}",
    "What differences are multiplied by": "Faktor, mit dem Differenzen multipliziert werden",
    "What drives the ego vehicle": "Was das Ego-Fahrzeug fährt",
    "What meeting another box counts, as a distance": "Was das Treffen einer anderen Box zählt, als Abstand",
    "What renders images and sweeps": "Was Bilder und Sweeps rendert",
    "What takes 1 s takes {duration}": "Was 1 s dauert, dauert {duration}",
    "What users should know: vehicle, calibration, date": "Was Benutzer wissen sollten: Fahrzeug, Kalibrierung, Datum",
    "When a sensor sees the body of the ego vehicle": "Wann ein Sensor die Karosserie des Ego-Fahrzeugs sieht",
    "Where": "Wohin",
    "Where the line between the recorded and the rendered image is, as a share of the image's width": (
        "Wo die Linie zwischen dem aufgezeichneten und dem gerenderten Bild liegt, als Anteil der Bildbreite"
    ),
    "Where the process of the driver listens: HOST:PORT, or unix:PATH": (
        "Wo der Prozess des Fahrers hört: HOST:PORT oder unix:PFAD"
    ),
    "Where the units of the batch are run": "Wo die Einheiten des Stapels ausgeführt werden",
    "Which images the view shows": "Welche Bilder die Ansicht zeigt",
    "Width": "Breite",
    "Within": "Innerhalb",
    "Workers": "Worker",
    "Workers of Ray: on this machine, or on the cluster whose address is given": (
        "Worker von Ray: auf diesem Rechner oder auf dem Cluster, dessen Adresse angegeben ist"
    ),
    "World location of the object at that time": "Position des Objekts in der Welt zu dieser Zeit",
    "World origin": "Ursprung der Welt",
    "Write every variant as a scenario file into a folder": "Jede Variante als Szenariodatei in einen Ordner schreiben",
    "Write the actors of the trained scene to a .blend file of assets": (
        "Die Akteure der trainierten Szene als Assets in eine .blend-Datei schreiben"
    ),
    "Write the edits of the scene to a scenario file for the command unisim render": (
        "Die Änderungen der Szene in eine Szenariodatei für den Befehl unisim render schreiben"
    ),
    "Yaw": "Gieren",
    "accel.": "Beschl.",
    "accelerates at {value:.1f} m/s²": "beschleunigt mit {value:.1f} m/s²",
    "added": "hinzugefügt",
    "added, off the vehicle": "hinzugefügt, nicht am Fahrzeug",
    "and {count} more": "und {count} weitere",
    "another lens": "anderes Objektiv",
    "as recorded": "wie aufgezeichnet",
    "at the same times, as it stands there throughout": "zu denselben Zeiten, da es durchweg dort steht",
    "brakes at {value:.1f} m/s²": "bremst mit {value:.1f} m/s²",
    "by up to {away}": "um bis zu {away}",
    'camera "{name}" has no images in the output folder': "Kamera „{name}“ hat keine Bilder im Ausgabeordner",
    "choose an actor by its thumbnail first": "zuerst einen Akteur an seinem Bild auswählen",
    "copy": "Kopie",
    "corners at {value:.1f} m/s²": "fährt Kurven mit {value:.1f} m/s² Querbeschleunigung",
    "curv.": "Krümm.",
    'curve "{name}" has fewer than two points': "Kurve „{name}“ hat weniger als zwei Punkte",
    "drives sideways": "fährt quer",
    "edited blue": "geändert blau",
    "edited blue, recorded grey": "geändert blau, aufgezeichnet grau",
    "exit status {code}": "Exit-Status {code}",
    "goes {speed:.0f} km/h": "bewegt sich mit {speed:.0f} km/h",
    "has an extent of {size:.3g} m": "hat eine Ausdehnung von {size:.3g} m",
    "has a scale that changes over time, which cannot be rendered: delete the keys of its scale, and what else animates it": (
        "hat eine Skalierung, die sich mit der Zeit ändert, was sich nicht rendern lässt: die Schlüsselbilder seiner "
        "Skalierung löschen, und was sie sonst animiert"
    ),
    "hidden": "ausgeblendet",
    "inserted": "eingefügt",
    "is mirrored by a negative scale, which cannot be rendered: make its scale, and that of its parent, positive": (
        "ist durch eine negative Skalierung gespiegelt, was sich nicht rendern lässt: seine Skalierung und die des "
        "übergeordneten Objekts positiv machen"
    ),
    "is scaled by {factors}, beyond {least:g} to {most:g}": (
        "ist mit {factors} skaliert, außerhalb von {least:g} bis {most:g}"
    ),
    (
        "is sheared by the scale of its parent, which cannot be rendered: clear the parent's scale, or scale it alike "
        "along all axes"
    ): (
        "ist durch die Skalierung des übergeordneten Objekts geschert, was sich nicht rendern lässt: dessen Skalierung "
        "zurücksetzen oder es entlang aller Achsen gleich skalieren"
    ),
    "is {height:.1f} m above the ground": "ist {height:.1f} m über dem Boden",
    "is {height:.1f} m below the ground": "ist {height:.1f} m unter dem Boden",
    "kept to it": "nicht verlassen",
    "lateral": "quer",
    "left it": "verlassen",
    "limits exceeded": "Grenzen überschritten",
    "looks from {length:.1f} m beside anything recorded": "blickt von {length:.1f} m neben allem Aufgezeichneten",
    "looks {share:.0%} beside all that was recorded": "blickt zu {share:.0%} neben alles Aufgezeichnete",
    "mesh": "Mesh",
    "module:function of a Setup that returns a driver, in a module that Python finds": (
        "Modul:Funktion eines Setups, die einen Fahrer zurückgibt, in einem Modul, das Python findet"
    ),
    "never": "nie",
    "no active actor": "kein aktiver Akteur",
    "no selected object has a surface": "kein ausgewähltes Objekt hat eine Oberfläche",
    'no sensor "{name}" in scene "{scene}"': "kein Sensor „{name}“ in Szene „{scene}“",
    "no trained scene": "keine trainierte Szene",
    "none is active": "keiner ist aktiv",
    "none: see Simulate": "keiner: siehe Simulieren",
    "not on the vehicle": "nicht am Fahrzeug",
    "not present": "nicht anwesend",
    "not there now": "jetzt nicht da",
    'object "{name}": has keys or constraints, and a body is fixed to the vehicle: clear them': (
        "Objekt „{name}“: hat Schlüsselbilder oder Constraints, aber eine Karosserie ist am Fahrzeug fest: diese löschen"
    ),
    'object "{name}": is scaled by {factors}; along each axis an actor can be scaled by {least:g} to {most:g}': (
        "Objekt „{name}“: ist mit {factors} skaliert; entlang jeder Achse lässt sich ein Akteur mit {least:g} bis {most:g} "
        "skalieren"
    ),
    'object "{name}": {why}': "Objekt „{name}“: {why}",
    "on a trajectory of its own": "auf einer eigenen Trajektorie",
    "other beams": "andere Strahlen",
    "overlaps {other}": "überlappt {other}",
    "points": "Punkte",
    "recorded": "aufgezeichnet",
    "recorded, moved": "aufgezeichnet, verschoben",
    "recorded, other appearance": "aufgezeichnet, anderes Aussehen",
    "rendered": "gerendert",
    "speed x{speed:.3g} for {duration}": "Geschwindigkeit x{speed:.3g} für {duration}",
    "speed x{speed:.3g} from {time} on": "Geschwindigkeit x{speed:.3g} ab {time}",
    "stands for {duration}": "steht für {duration}",
    "the active actor": "den aktiven Akteur",
    "the log itself is not at hand": "das Log selbst ist nicht verfügbar",
    "trained scene {name}": "trainierte Szene {name}",
    "turned by {angle}": "um {angle} gedreht",
    "turned {angle} left": "um {angle} nach links gedreht",
    "turned {angle} right": "um {angle} nach rechts gedreht",
    "turns at a radius of {radius:.1f} m ({curvature:.2f} 1/m)": (
        "fährt Kurven mit {radius:.1f} m Radius ({curvature:.2f} 1/m)"
    ),
    "unsaved file": "ungespeicherte Datei",
    "up to {length:.0f} m": "bis zu {length:.0f} m",
    "within limits": "in den Grenzen",
    "{actors} ({classes})": "{actors} ({classes})",
    "{actor} of {scene}": "{actor} aus {scene}",
    "{angle:.0f} degrees across": "{angle:.0f} Grad horizontal",
    "{angle:.1f}° down": "{angle:.1f}° nach unten",
    "{angle:.1f}° left": "{angle:.1f}° nach links",
    "{angle:.1f}° right": "{angle:.1f}° nach rechts",
    "{angle:.1f}° up": "{angle:.1f}° nach oben",
    "{before} become {after}": "{before} werden {after}",
    "{camera} has no recorded image of frame {frame:g}": (
        "{camera} hat zu Bild {frame:g} kein aufgezeichnetes Kamerabild"
    ),
    "{camera} is an added camera: it has no recorded image": (
        "{camera} ist eine hinzugefügte Kamera: sie hat kein aufgezeichnetes Bild"
    ),
    "{camera} is not where it recorded: no recorded image shows this view": (
        "{camera} ist nicht, wo sie aufgezeichnet hat: kein aufgezeichnetes Bild zeigt diese Ansicht"
    ),
    "{camera} looks beside its recorded images": "{camera} blickt neben ihre aufgezeichneten Bilder",
    "The lens of {camera} bends lines: outlines and images follow it, Blender's own boxes do not": (
        "Das Objektiv von {camera} krümmt Geraden: Umrisse und Bilder folgen ihm, Blenders eigene Boxen nicht"
    ),
    "{camera} was moved: its recorded image is not shown": (
        "{camera} wurde verschoben: ihr aufgezeichnetes Bild wird nicht gezeigt"
    ),
    "{count} LiDARs": "{count} LiDARs",
    "{count} actors": "{count} Akteure",
    "{count} beams": "{count} Strahlen",
    "{count} cameras": "{count} Kameras",
    "{count} edits": "{count} Änderungen",
    "{count} frames ({time:.1f} s)": "{count} Bilder ({time:.1f} s)",
    "{count} listed frames": "{count} aufgezählte Bilder",
    "{count} others": "{count} andere",
    "{count} sensors at times of their own": "{count} Sensoren mit eigenen Zeitpunkten",
    "{count} times": "{count} Zeitpunkte",
    "{count}, at fault: {fault}": "{count}, verschuldet: {fault}",
    "{difference}: mean absolute error {error:.1f} of 255, PSNR {psnr:.1f} dB": (
        "{difference}: mittlerer absoluter Fehler {error:.1f} von 255, PSNR {psnr:.1f} dB"
    ),
    "{done:.1f} of {total:.1f} minutes": "{done:.1f} von {total:.1f} Minuten",
    "{done}  |  Ctrl: steps, Esc: cancel": "{done}  |  Strg: in Schritten, Esc: abbrechen",
    "{done} of {total} frames": "{done} von {total} Bildern",
    "{done} of {total} steps": "{done} von {total} Schritten",
    "{done} of {total} units": "{done} von {total} Einheiten",
    "{duration} earlier": "{duration} früher",
    "{duration} later": "{duration} später",
    "{edits}, {muted} muted": "{edits}, {muted} stummgeschaltet",
    "{first}–{last} of {count}": "{first}–{last} von {count}",
    '{folder}: has no actor "{name}"': "{folder}: hat keinen Akteur „{name}“",
    "{folder}: holds no finished rollout": "{folder}: enthält keinen fertigen Rollout",
    "{folder}: save the .blend first, or choose a folder that does not depend on it": (
        "{folder}: zuerst die .blend-Datei speichern oder einen Ordner wählen, der nicht von ihr abhängt"
    ),
    "{frames} of {count} variants": "{frames} von {count} Varianten",
    "{frames}, step {step}": "{frames}, Schrittweite {step}",
    "{length:.1f} m at most": "höchstens {length:.1f} m",
    "{length:.1f} m before the curve's end": "{length:.1f} m vor dem Ende der Kurve",
    "{length:.1f} m in {duration}": "{length:.1f} m in {duration}",
    "{length:.1f} m take {duration}": "{length:.1f} m dauern {duration}",
    "{length:.2f} m backward": "{length:.2f} m rückwärts",
    "{length:.2f} m forward": "{length:.2f} m vorwärts",
    "{length:.2f} m to the left": "{length:.2f} m nach links",
    "{length:.2f} m to the right": "{length:.2f} m nach rechts",
    "{length} away": "{length} entfernt",
    "{length} back": "{length} zurück",
    "{length} down": "{length} nach unten",
    "{length} forward": "{length} vorwärts",
    "{length} left": "{length} nach links",
    "{length} right": "{length} nach rechts",
    "{length} up": "{length} nach oben",
    "{log}: the log is not at hand, so no recorded points are shown": (
        "{log}: das Log ist nicht verfügbar, daher werden keine aufgezeichneten Punkte gezeigt"
    ),
    "{name} ({number} of {count}): {done} of {total}; {frames} in all": (
        "{name} ({number} von {count}): {done} von {total}; insgesamt {frames}"
    ),
    "{name} beside {other}": "{name} neben {other}",
    "{name} is deleted; {other} is shown": "{name} ist gelöscht; {other} wird gezeigt",
    "{name} is muted": "{name} ist stummgeschaltet",
    "{name} is not in the scene": "{name} ist nicht in der Szene",
    "{name} is shown now; edits here do not change the others": (
        "{name} wird jetzt gezeigt; Änderungen hier ändern die anderen nicht"
    ),
    "{name} is the ego vehicle's body": "{name} ist die Karosserie des Ego-Fahrzeugs",
    "{name}, {speed:.1f} m/s": "{name}, {speed:.1f} m/s",
    "{name}, {start:.1f} to {end:.1f} s": "{name}, {start:.1f} bis {end:.1f} s",
    "{name}: is scaled by {factors} to {size}; its underside stays where it was": (
        "{name}: ist mit {factors} auf {size} skaliert; die Unterseite bleibt, wo sie war"
    ),
    "{name}: its mount is changed": "{name}: die Montage ist geändert",
    "{name}: looks {yaw}, {pitch}": "{name}: blickt {yaw}, {pitch}",
    "{name}: measures {size}": "{name}: misst {size}",
    "{name}: the change is keyed at frame {frame} and blends in from {blend:g} s before to {blend:g} s after it": (
        "{name}: die Änderung hat ein Schlüsselbild bei Bild {frame} und wird von {blend:g} s davor bis {blend:g} s danach "
        "überblendet"
    ),
    "{name}: the ground height is unknown there": "{name}: die Höhe des Bodens ist dort unbekannt",
    "{name}: the scale changes at all its keys": "{name}: die Skalierung ändert sich an allen Schlüsselbildern",
    "{name}: the whole trajectory and its keys are displaced": (
        "{name}: die ganze Trajektorie mit ihren Schlüsselbildern ist verschoben"
    ),
    "{name}: the whole trajectory is displaced": "{name}: die ganze Trajektorie ist verschoben",
    "{name}: there is no such variant any more": "{name}: diese Variante gibt es nicht mehr",
    "{name}: this edit is not there any more": "{name}: diese Änderung gibt es nicht mehr",
    "{name}: {length:.2f} m at {time}": "{name}: {length:.2f} m bei {time}",
    "{name}: {sensors} put on the vehicle": "{name}: {sensors} am Fahrzeug angebracht",
    "{number} of {count}": "{number} von {count}",
    "{number} of {count} listed actors are visible and selected": (
        "{number} von {count} gelisteten Akteuren sind sichtbar und ausgewählt"
    ),
    "{path}: cannot be deleted: {why}": "{path}: lässt sich nicht löschen: {why}",
    "{path}: is no rig preset in Blender's presets folders": "{path}: ist kein Rig-Preset in Blenders Preset-Ordnern",
    "{path}: is there already: choose another name, or replace it": (
        "{path}: existiert schon: einen anderen Namen wählen oder das Preset ersetzen"
    ),
    "{progress}, starting": "{progress}, startet",
    "{progress}, {time} left": "{progress}, noch {time}",
    "{rate:g} Hz": "{rate:g} Hz",
    "{saved}; left out, because they are no mounted cameras or beam tables: {names}": (
        "{saved}; ausgelassen, da sie keine montierten Kameras oder Strahlentabellen sind: {names}"
    ),
    "{seconds:.1f} s at {time:.1f} s": "{seconds:.1f} s bei {time:.1f} s",
    "{sensors} saved to {path}": "{sensors} nach {path} gespeichert",
    "{sensor} added": "{sensor} hinzugefügt",
    "{sensor} copied": "{sensor} kopiert",
    "{sensor} removed": "{sensor} entfernt",
    "{sentence} (and {count} more)": "{sentence} (und {count} weitere)",
    "{start:.1f} to {end:.1f} s": "{start:.1f} bis {end:.1f} s",
    "{start:g} to {stop:g} s, {rate:g} Hz": "{start:g} bis {stop:g} s, {rate:g} Hz",
    "{state}: it was recorded at x {x:.1f} m, y {y:.1f} m": "{state}: aufgezeichnet bei x {x:.1f} m, y {y:.1f} m",
    "{text} (Esc to cancel)": "{text} (Esc bricht ab)",
    "{time:.2f} s (frame {frame:.1f})": "{time:.2f} s (Bild {frame:.1f})",
    "{time:.2f} s ({frames:.1f} frames)": "{time:.2f} s ({frames:.1f} Bilder)",
    "{time} (frame {frame:g}): {speed}": "{time} (Bild {frame:g}): {speed}",
    "{time} s": "{time} s",
    "{units}, {count} failed": "{units}, {count} fehlgeschlagen",
    "{unmuted}; muted instead: {others}": "{unmuted}; stattdessen stummgeschaltet: {others}",
    "{shift} along its own axis, as it stands still": "{shift} entlang der eigenen Achse, da es stillsteht",
    "{shift} along its path": "{shift} entlang des eigenen Pfads",
    "{whole}; the log ends at {time:.2f} s": "{whole}; das Log endet bei {time:.2f} s",
    "|recorded - rendered| x{gain:g}": "|aufgezeichnet - gerendert| x{gain:g}",
}
